"""The palette module against its formula in float64, by hand numbers, and through a file."""

import json

import numpy as np
import pytest
import torch

from stylerf.editing.palette_module import Mixture, PaletteModule, box_around, clustered_palette, random_palette
from stylerf.errors import InvalidValue
from stylerf.fields.hash_encoding import HashEncoding
from stylerf.fields.palette_edits import PaletteEdits
from stylerf.geometry.spherical_harmonics import harmonics
from tests.stylerf.editing.region_pictures import PLAIN
from tests.stylerf.kernels import torch_reference
from tests.stylerf.small import close, float64

LAYOUT = {"levels": 8, "base": 3, "finest": 20, "table": 256}


def module(count: int = 4, seed: int = 0) -> PaletteModule:
    generator = np.random.default_rng(seed)
    encoding = HashEncoding.create(generator, **LAYOUT, spread=1.0)
    box = np.array([[0.2, 0.3, 0.4], [0.6, 0.6, 0.5]], np.float32)
    made = PaletteModule.create(generator, generator.random((count, 3)), box, encoding)
    made.values[3 * count :] = generator.normal(scale=0.3, size=len(made.values) - 3 * count)
    return made


def places(count: int = 40, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    generator = np.random.default_rng(seed)
    directions = generator.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return generator.uniform(0.3, 0.5, (count, 3)).astype(np.float32), directions.astype(np.float32)


def slow(made: PaletteModule, x, directions) -> Mixture:
    """The formula in float64, networks written out."""
    e, count = made.encoding, len(made.active)
    values, at = float64(made.values), 3 * count
    local = ((float64(x) - float64(made.box[0])) / float64(made.box[1] - made.box[0])).clamp(0, 1)
    phi = torch_reference.hash_levels(float64(e.values), e.levels, e.base, e.finest, e.table, local).flatten(1)
    found = []
    for hidden, last in ((phi, count), (torch.cat([phi, float64(harmonics(directions, 2))], 1), 3)):
        for number, wide in enumerate((64, 64, last)):
            inside = hidden.shape[1]
            weight = values[at : at + inside * wide].reshape(wide, inside)
            hidden = hidden @ weight.T + values[at + inside * wide : at + (inside + 1) * wide]
            hidden = hidden.clamp(min=0) if number < 2 else hidden
            at += (inside + 1) * wide
        found.append(hidden)
    assert at == len(values)
    scores = found[0].exp() * torch.from_numpy(made.active)
    weights = (scores / scores.sum(1, keepdim=True))[:, torch.from_numpy(made.active)]
    palette = values[: 3 * count].reshape(count, 3)[torch.from_numpy(made.active)]
    offsets = found[1].tanh()
    return Mixture(weights, offsets, (weights @ palette + offsets).clamp(0, 1))


@pytest.mark.parametrize("removed", [(), (1,), (0, 1, 3)])
def test_colors_are_the_formula_over_active_colors_alone(removed):
    made = module()
    made.active[list(removed)] = False
    x, directions = places()
    expected = slow(made, x, directions)
    found = made.mixture(x, directions, threads=2)
    close(found.weights, expected.weights, 1e-5)
    close(found.offsets, expected.offsets, 1e-5)
    close(made.colors(x, directions), expected.colors, 1e-5)
    assert made.weights(x).shape == (40, 4 - len(removed)) and (expected.offsets.abs() > 0.1).any()
    np.testing.assert_allclose(made.weights(x).sum(1), 1, rtol=1e-6)
    np.testing.assert_allclose(made.weights(x), found.weights, rtol=1e-6)  # not a matter of the direction


def test_gradients_reach_every_part_and_equal_those_in_float64():
    made = module()
    made.active[2] = False
    x, directions = places()
    pulls = torch.randn(40, 3, generator=torch.Generator().manual_seed(2))
    to = np.zeros((2, len(made.encoding.values)), np.float32)
    values = made.leaf()
    basis = torch.from_numpy(harmonics(directions, 2))
    (made.mix(values, made.encoding(made.local(x), to), basis).colors * pulls).sum().backward()
    along = np.random.default_rng(3).normal(size=len(made.values))
    ends = []
    for step in (-1e-5, 1e-5):
        other = module()
        other.active[2] = False
        other.values = other.values + step * along  # float64: slow() takes what it is given
        ends.append(float((slow(other, x, directions).colors * pulls).sum()))
    assert float(values.grad.double() @ torch.from_numpy(along)) == pytest.approx((ends[1] - ends[0]) / 2e-5, rel=2e-3)
    assert (values.grad[6:9] == 0).all() and np.abs(to).max() > 0  # the removed color learns nothing


def even_module(offset: float) -> PaletteModule:
    """Two colors with weights 3/4 and 1/4 everywhere, and one offset everywhere."""
    made = module(2)
    made.values[6:] = 0
    made.values[:6] = [0.8, 0.4, 0.0, 0.0, 0.4, 0.8]
    outputs = 6 + 33 * 64 + 65 * 64 + 64 * 2
    made.values[outputs : outputs + 2] = np.log(3), 0
    made.values[-3:] = np.arctanh(offset)
    return made


def test_edits_and_their_transition_by_hand():
    made = even_module(0.1)
    x, directions = places(3)
    np.testing.assert_allclose(made.colors(x, directions)[0], [0.7, 0.5, 0.3], atol=1e-6)
    edits = PaletteEdits(colors={0: (0.0, 0.0, 0.6)}, scales={1: 3.0})
    # Weights 3/4, 3/4 -> 1/2, 1/2. Palette (0, 0, .6), (0, .4, .8): (0, .2, .7) and the offset.
    np.testing.assert_allclose(made.colors(x, directions, edits)[0], [0.1, 0.3, 0.8], atol=1e-6)
    found = made.colors(x, directions, edits, np.array([0, 1, 0.5]))
    np.testing.assert_allclose(found[0], [0.1, 0.3, 0.8], atol=1e-6)
    np.testing.assert_allclose(found[1], [0.7, 0.5, 0.3], atol=1e-6)
    # Half way: weights 5/8, 3/8, palette (.4, .2, .3), (0, .4, .8). The middle of the colors would be (.4, .4, .55).
    np.testing.assert_allclose(found[2], [0.35, 0.375, 0.5875], atol=1e-6)
    for nothing in (None, PaletteEdits()):
        assert np.array_equal(made.colors(x, directions, nothing, np.ones(3)), made.colors(x, directions))


def test_indices_count_active_colors():
    made = module()
    made.active[1] = False
    np.testing.assert_array_equal(made.palette, made.values[:12].reshape(4, 3)[[0, 2, 3]])
    x, directions = places(2)
    with pytest.raises(InvalidValue, match="color 3 does not exist; there are 0 to 2"):
        made.colors(x, directions, PaletteEdits(colors={3: (0, 0, 0)}))
    assert made.colors(x[:0], directions[:0]).shape == (0, 3)


def test_goes_through_a_file_bit_by_bit_and_refuses_another_length():
    made = module()
    made.active[3] = False
    x, directions = places()
    data = json.loads(json.dumps(made.describe()))
    again = PaletteModule.restore(data, made.arrays())
    assert np.array_equal(again.colors(x, directions), made.colors(x, directions))
    with pytest.raises(InvalidValue, match="finite values"):
        PaletteModule.restore(data, made.arrays() | {"networks": made.values[:-1]})
    with pytest.raises(InvalidValue, match="one of them active"):
        PaletteModule.restore(data | {"active": [False] * 4}, made.arrays())


def test_first_palettes():
    generator = np.random.default_rng(0)
    colors = PLAIN[generator.integers(0, 4, 4000)] + generator.normal(scale=0.01, size=(4000, 3))
    found = clustered_palette(np.random.default_rng(1), colors, 4)
    assert np.abs(found[:, None] - PLAIN).max(-1).min(0).max() < 0.01
    assert np.array_equal(found, clustered_palette(np.random.default_rng(1), colors, 4))
    # Fewer different colors than clusters: no cluster is lost in a division by zero.
    assert np.isfinite(clustered_palette(np.random.default_rng(1), np.full((9, 3), 0.5), 4)).all()
    even = random_palette(np.random.default_rng(2), 500)
    assert 0 <= even.min() < 0.02 and 0.98 < even.max() < 1 and abs(even.mean() - 0.5) < 0.03


def test_box_around_points():
    box = box_around(np.array([[0.2, 0.4, 0.5], [0.6, 0.5, 0.5]], np.float32))
    np.testing.assert_allclose(box, [[0.18, 0.395, 0.478], [0.62, 0.505, 0.522]], atol=1e-6)
