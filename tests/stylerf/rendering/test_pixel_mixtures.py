"""Mean mixtures of pixels: of one sample exact, of several the weighted mean, and only of the part that is mixed."""

import numpy as np
import pytest

from stylerf.editing.edited_color import EditedColor
from stylerf.editing.palette_module import PaletteModule
from stylerf.fields.palette_color import PaletteColor
from stylerf.fields.palette_edits import PaletteEdits, Recoloring
from stylerf.kernels.cpu.ray_samples import Samples
from stylerf.rendering.pixel_mixtures import Mixing, MixtureRecorder, colors_of
from tests.stylerf.kernels.cpu.test_vm import basis_of, samples
from tests.stylerf.small import vm_color

PALETTE = np.float32([[0.7, 0.2, 0.1], [0.1, 0.3, 0.6], [0.2, 0.5, 0.2]])
CHANGES = PaletteEdits({0: (0.2, 0.3, 0.6)}, {1: 0.3}, {2: 0.1})


def palettes(changes: PaletteEdits) -> PaletteColor:
    color = PaletteColor.create(np.random.default_rng(4), PALETTE, 8, 40, 512, base=3)
    color.table[:] = np.random.default_rng(5).normal(scale=0.4, size=len(color.table))
    return color.edited(Recoloring(changes)) if changes else color


BASE, MARKED = vm_color(1), np.indices((4, 4, 4))[0] >= 2
MODULE = PaletteModule.create(np.random.default_rng(0), PALETTE, np.float32([[0, 0, 0], [1, 1, 1]]))


def edited(changes: PaletteEdits) -> EditedColor:
    return EditedColor(BASE, MODULE, MARKED, changes)


def recorded(color: Mixing, points: Samples) -> tuple[MixtureRecorder, np.ndarray]:
    recorder = MixtureRecorder(color)
    return recorder, recorder.colors(points.shading_points(), basis_of(points, 2), 2)


@pytest.mark.parametrize("kind", [palettes, edited])
def test_pixels_of_single_samples_are_recolored_exactly(kind):
    points, color, changed = samples(3), kind(PaletteEdits()), kind(CHANGES)
    first = np.arange(len(points.ends))[points.ends > points.starts]
    points.weights[:] = 0
    points.weights[points.starts[first]] = 0.7
    basis = basis_of(points, 2)
    recorder, own = recorded(color, points)
    own = own[points.starts[first]]
    np.testing.assert_array_equal(own, color.colors(points.shading_points(), basis, 2)[points.starts[first]])
    wanted = changed.colors(points.shading_points(), basis, 2)[points.starts[first]]
    mixed = recorder.shares[first] > 0
    assert mixed.any() and np.isin(recorder.shares, (0, 1)).all()
    found = colors_of(changed, recorder.means, None)[first]
    np.testing.assert_allclose(found[mixed], wanted[mixed], atol=2e-6)
    assert np.abs(wanted - own)[mixed].max() > 0.02
    np.testing.assert_array_equal(wanted[~mixed], own[~mixed])


def test_means_and_shares_are_weighted_sums():
    points = samples(3)
    points.weights[:] = np.random.default_rng(0).random(len(points.weights))
    recorder, _ = recorded(edited(PaletteEdits()), points)
    basis, cells = basis_of(points, 2), (points.x * 4).astype(int).clip(0, 3)
    for r, (start, end) in enumerate(zip(points.starts, points.ends)):
        total, mixed, inside = np.zeros(len(PALETTE) + 3), 0.0, 0.0
        for k in range(start, end):
            mixed += points.weights[k]
            if MARKED[tuple(cells[k])]:
                one = MODULE.mixture_of(points.x[k : k + 1], basis[r : r + 1])
                total += points.weights[k] * np.concatenate([one.weights.numpy()[0], one.offsets.numpy()[0]])
                inside += points.weights[k]
        assert recorder.shares[r] == pytest.approx(inside / max(mixed, 1e-9), abs=1e-5)
        np.testing.assert_allclose(recorder.means[r], total / max(inside, 1e-9), atol=1e-5)


def test_other_mixtures_are_told_apart():
    plain, other = palettes(PaletteEdits()), PaletteColor.create(np.random.default_rng(4), PALETTE, 8, 40, 512, base=3)
    assert plain.mixes_as(plain.edited(Recoloring(CHANGES))) and not plain.mixes_as(other)
    elsewhere = EditedColor(BASE, MODULE, ~MARKED, PaletteEdits())
    assert edited(PaletteEdits()).mixes_as(edited(CHANGES)) and not edited(CHANGES).mixes_as(elsewhere)
    assert not plain.mixes_as(edited(CHANGES)) and not edited(CHANGES).mixes_as(plain)
    assert not isinstance(BASE, Mixing)
