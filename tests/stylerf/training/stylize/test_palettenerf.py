"""Learning a scene's palette: what each part of the loss is, when it counts, what it comes to, going on."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from stylerf.editing.extraction import EditView
from stylerf.editing.palette_losses import weight_variation
from stylerf.errors import InvalidValue
from stylerf.fields.palette_color import PaletteColor, Parts
from stylerf.fields.palette_edits import Recoloring
from stylerf.rendering.view import render_view
from stylerf.training.stylize.palettenerf import (
    DecompositionWeights,
    PaletteNerf,
    _Seen,
    picture_variation,
    roughness,
)
from stylerf.training.stylize.settings import StyleSettings
from stylerf.training.stylize.trainer import StylizationTrainer
from tests.stylerf.training.running import Stopped, assert_same_bits, result_of, resumed
from tests.stylerf.training.stylizing import GRAY, HEIGHT, VIEWS, WIDTH, problem, stopping

PLAIN = np.array([[0.8, 0.1, 0.1], [0.1, 0.6, 0.2], [0.1, 0.2, 0.8], [0.9, 0.85, 0.3]], np.float32)


def photo(seed: int) -> np.ndarray:
    """Quarters of the four colors, lit unevenly."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    quarter = (rows >= HEIGHT // 2) * 2 + (columns >= WIDTH // 2)
    light = 0.85 + 0.15 * np.sin(rows + 0.5 * columns + seed)
    return (PLAIN[quarter] * light[..., None]).astype(np.float32)


def decomposing(
    seed: int = 0, weights: DecompositionWeights | None = None, raw: float = 1.0, **given
) -> StylizationTrainer:
    """A fog as opaque as `raw` says, seen in three photos."""
    small = {"steps": 12, "refit_steps": 8, "refit_pixels": 128, "weight_threshold": 0.1}
    settings = StyleSettings(**{**small, "match": "none", "final_rate": 0.1, **given})

    def new_color(generator, pixel_cells, palette):
        return PaletteColor.create(generator, palette, 8, 40, 512, base=3)

    made = replace(problem(settings, seed, raw=raw, style_image=None), photos=[photo(i) for i in range(VIEWS)])
    return StylizationTrainer(PaletteNerf.create(made, weights or DecompositionWeights(), 4, new_color))


@pytest.mark.parametrize(
    ("step", "smooth", "guide", "drift"),
    [(0, 0.0, 0.05, 0.0), (2, 4e-3, 0.05 * 0.5, 0.0), (3, 4e-3, 0.05 * 0.25, 0.0), (4, 4e-3, 0.0, 1e-3)],
)
def test_parts_count_when_their_time_has_come(step, smooth, guide, drift):
    one = decomposing(steps=12)
    one.state.phase, one.state.step = "style", step
    scales = one.method._scales()
    assert (scales["smooth"], scales["drift"]) == (smooth, drift)
    assert scales["guide"] == pytest.approx(guide, abs=1e-12)
    assert (scales["sparsity"], scales["offset"], scales["view"]) == (2e-3, 0.03, 0.1)


def test_parts_of_the_loss_are_those_written_ray_by_ray():
    one, pixels = decomposing(raw=-2.0), np.array([40, 41, 100, 133, 200])
    seen, wanted = _Seen(one.scene, one.method.color, 1, pixels), photo(1).reshape(-1, 3)[pixels]
    with torch.no_grad():
        found = one.method._image_losses(seen, wanted, True) | one.method._palette_losses(
            seen, np.random.default_rng(0)
        )
    starts, ends, x, weights = one.scene.fixed.surface(1).samples(pixels)
    assert (ends - starts).max() > 1
    p, palette = seen.parts, one.method.extracted.palette.astype(np.float64)
    d, s, w, o, lit = (v.detach().double().numpy() for v in (p.diffuse, p.specular, p.weights, p.offsets, p.intensity))
    expected = dict.fromkeys(("direct", "mse", "view", "guide", "sparsity", "offset"), 0.0)
    for r, pixel in enumerate(pixels):
        alpha = float(one.scene.fixed.alpha(1).ravel()[pixel])
        direct, mixed, mixture = np.zeros(3), np.zeros(3), np.zeros(4)
        for k in range(starts[r], ends[r]):
            direct += weights[k] * (d[k] + s[k])
            mixed += weights[k] * (lit[k, 0] * sum(w[k, i] * (palette[i] + o[k, i]) for i in range(4)) + s[k])
            mixture += weights[k] * w[k]
            expected["view"] += weights[k] * (s[k] ** 2).sum() / 5
            expected["offset"] += weights[k] * (o[k] ** 2).sum() / 5
            expected["sparsity"] += weights[k] * (w[k].sum() / (w[k] ** 2).sum() - 1) / 5
        gap = (1 - alpha) * GRAY - wanted[r]
        expected["direct"] += ((direct + gap) ** 2).sum() / 15
        expected["mse"] += ((mixed + gap) ** 2).sum() / 15
        expected["guide"] += ((mixture - alpha * one.method.extracted.weights_of(wanted[r : r + 1])[0]) ** 2).sum() / 20
    for name, value in expected.items():
        assert float(found[name]) == pytest.approx(value, rel=2e-4, abs=1e-7), name
    assert float(found["drift"]) == 0 and x.shape[1] == 3


def test_roughness_counts_near_places_of_like_color():
    def parts(diffuse, weights):
        return Parts(
            torch.tensor([diffuse]), torch.zeros(1, 3), torch.tensor([weights]), torch.zeros(1, 2, 3), torch.ones(1, 1)
        )

    one, other = parts([0.5, 0.5, 0.5], [0.8, 0.2]), parts([0.5, 0.6, 0.7], [0.5, 0.5])
    found = roughness(one, other, torch.tensor([1e-4]))
    # (0.3^2 + 0.3^2) exp(-4 1e-4 / 0.005 - 0.05 / 0.2)
    assert float(found) == pytest.approx(0.18 * np.exp(-0.08 - 0.25), rel=1e-5)


def test_the_picture_of_weights_varies_as_that_of_a_local_edit():
    generator = np.random.default_rng(0)
    weights, alpha = generator.random((5, 7, 3)), generator.random((5, 7)).astype(np.float32)
    shown = alpha > 0.3
    pixels = np.flatnonzero(shown)
    zeros = np.zeros((len(pixels), 3), np.float32)
    view = EditView(0, 7, 5, pixels, zeros, zeros, zeros, zeros, *(alpha.ravel()[pixels],) * 5,
                    zeros[:, :2])  # fmt: skip
    expected = weight_variation(weights.reshape(-1, 3)[pixels], view)
    assert picture_variation(weights, alpha, shown) == pytest.approx(expected, rel=1e-9)


def test_the_refit_teaches_the_direct_color_and_the_palette_waits():
    one, palettes = decomposing(steps=12), {}
    one.run(lambda now: palettes.setdefault((now.state.phase, now.state.step), now.scene.field.color.palette.copy()))
    first = one.method.extracted.palette
    assert np.array_equal(palettes["refit", 8], first) and np.array_equal(palettes["style", 4], first)
    assert not np.array_equal(palettes["style", 12], first)


def test_a_scene_of_four_colors_is_decomposed_into_them():
    """The palette's picture comes near the photos, its mixes are few, and figures tell as much."""
    one = decomposing(steps=150, refit_steps=60, refit_pixels=256, rate=1e-2)
    errors = []
    one.run(
        lambda now: (
            errors.append(now.method.figures()["psnr"])
            if now.state.phase == "style" and now.state.step in (1, 150)
            else None
        )
    )
    figures = one.method.figures()
    assert errors[1] > errors[0] + 3 and figures["psnr"] == errors[1]
    assert figures["colors"] == 4 and sum(figures["shares"]) == pytest.approx(1, abs=1e-3)
    edges = 2 * (HEIGHT + WIDTH) / (HEIGHT * WIDTH)  # palette TV of four quarters of one color each, opaque
    assert 0 <= figures["sparsity"] < 2.5 and 0.3 * edges < figures["palette_variation"] < edges
    before = render_view(one.scene.field, one.scene.cameras[0], threads=1).rgb
    one.scene.field.color = one.scene.field.color.edited(Recoloring())
    np.testing.assert_allclose(render_view(one.scene.field, one.scene.cameras[0], threads=1).rgb, before, atol=1e-5)


def test_shapes_stay_to_the_bit():
    one = decomposing()
    before = one.scene.field.density.values.copy()
    one.run()
    assert np.array_equal(one.scene.field.density.values, before) and one.scene.field.color_map is None


def test_a_stopped_decomposition_goes_on_to_the_same_bits():
    whole = decomposing()
    whole.run()
    expected, arrays = result_of(whole)
    at, on_step = decomposing(), stopping([3, 8, 10, 14])
    for _ in range(4):  # in the refit, at its end, before the palette's release, after it
        with pytest.raises(Stopped):
            at.run(on_step)
        at = resumed(decomposing(), at)
    at.run(on_step)
    state, found = result_of(at)
    assert state == expected and state["phase"] == "done"
    assert_same_bits(found, arrays)


def test_a_field_that_no_view_sees_has_no_palette():
    with pytest.raises(InvalidValue, match="no colors to decompose"):
        decomposing(raw=-40.0)
