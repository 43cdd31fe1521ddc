"""A region's own colors over a field's: values and gradients against the oracle, and nothing outside changes."""

import numpy as np
import pytest
import torch

from stylerf.errors import InvalidValue
from stylerf.fields.radiance_field import RadianceField
from stylerf.fields.region_color import MOST_REGIONS, RegionColor, box_of
from tests.stylerf.blends import layer, over
from tests.stylerf.kernels.cpu.test_vm import added, basis_of, buffers, owned, samples
from tests.stylerf.small import SPACES, close, field_of, float64, hash_color, oracle_color, vm_color

CELLS = 6


def marked_cells() -> np.ndarray:
    marked = np.zeros((CELLS,) * 3, bool)
    marked[2:5, 1:4, 3:5] = True
    marked[2, 1, 3] = False
    return marked


def patch() -> RegionColor:
    made = RegionColor.create(vm_color(4), marked_cells(), 30.0, table=64, levels=8)
    made.values[:] = np.random.default_rng(8).normal(scale=0.4, size=len(made.values))
    return made


def inside(x: np.ndarray) -> np.ndarray:
    at = np.minimum((x * CELLS).astype(int), CELLS - 1)
    return marked_cells()[tuple(at.T)]


def oracle(made: RegionColor, values: torch.Tensor, basis: torch.Tensor, x: torch.Tensor) -> torch.Tensor:
    """sigmoid(logit(base) + logit(own)) where a cell is marked, base elsewhere."""
    base = oracle_color(made.base, float64(made.base.values), basis, x)
    low, side = box_of(marked_cells())
    marked = torch.from_numpy(inside(x.detach().numpy()))
    own = oracle_color(made.own, values, None, (x[marked] - float64(low)) / side)
    both = torch.sigmoid(torch.logit(base[marked]) + torch.logit(own))
    return base.index_put((torch.nonzero(marked)[:, 0],), both)


def case():
    """Samples away from the sides of cells, where a slope has two answers; some of them without weight."""
    s = samples(2, 400)
    s.x[:] = np.random.default_rng(4).uniform(0.01, 0.99, s.x.shape)
    s.weights[[5, 17]] = 0
    at = owned(s)
    basis = basis_of(s, 1)
    rays = np.repeat(np.arange(len(s.ends)), s.ends - s.starts)
    assert 10 < inside(s.x[at]).sum() < len(at) - 10
    return s, at, basis, float64(basis)[rays], s.weights[at] > 0


def test_colors_and_gradients_equal_the_oracle():
    made, (s, at, basis, each, shown) = patch(), case()
    values, x = float64(made.values).requires_grad_(), float64(s.x[at]).requires_grad_()
    expected = oracle(made, values, each, x)
    gradients = np.random.default_rng(3).normal(size=(len(s.x), 3)).astype(np.float32)
    (expected * float64(gradients[at]))[shown].sum().backward()
    for threads in (1, 3):
        found = made.colors(s.shading_points(), basis, threads)
        close(found[at][shown], expected[shown], 5e-6)
        assert (found[at][~shown, 0] == -1).all() and (~shown).any()
        to = buffers(threads, len(made.values))
        made.backward(s.shading_points(), basis, found, gradients, to)
        close(added(to), values.grad, 1e-5)
        out = np.full(s.x.shape, 0.5, np.float32)
        made.add_position_gradients(s.shading_points(), basis, found, gradients, out, threads)
        close(out[at] - 0.5, x.grad, 2e-5)


def test_outside_its_cells_and_untrained_a_region_color_keeps_all_bits():
    made, (s, at, basis, _, shown) = patch(), case()
    base = made.base.colors(s.shading_points(), basis, 2)
    found = made.colors(s.shading_points(), basis, 2)
    within = inside(s.x[at]) & shown
    np.testing.assert_array_equal(found[at][~within & shown], base[at][~within & shown])
    assert (np.abs(found[at][within] - base[at][within]).max(1) > 0).all()
    made.values[:] = 0
    found = made.colors(s.shading_points(), basis, 2)
    np.testing.assert_allclose(found[at][shown], base[at][shown], atol=1e-6)


def test_a_patch_on_a_patch_comes_back_from_what_is_kept():
    low = patch()
    more = np.zeros((4,) * 3, bool)
    more[1:3, 1:3, 1:3] = True
    top = RegionColor.create(low, more, 20.0, table=64)
    top.values[:] = 0.3
    field = field_of(SPACES["box"], 3, color=top)
    again = RadianceField.restore(field.describe(), {k: v.copy() for k, v in field.arrays().items()})
    assert (
        again.parameters
        == field.parameters
        == len(field.density.values) + sum(len(one.values) for one in (top, low, low.base))
    )
    s, at, basis, _, shown = case()
    found = [p.colors(s.shading_points(), basis, 1)[at][shown] for p in (top, again.color, low)]
    np.testing.assert_array_equal(found[0], found[1])
    assert (found[0] != found[2]).any()


def test_the_box_holds_the_cells_and_no_more():
    low, side = box_of(marked_cells())
    np.testing.assert_allclose(low, [2 / CELLS, 1 / CELLS, 3 / CELLS])
    assert side == pytest.approx(3 / CELLS)


def test_what_could_not_be_read_back_is_not_put_together():
    """A region over a blend, and more regions over one another than are restored."""
    source = field_of(SPACES["box"], 3)
    with pytest.raises(InvalidValue, match="a region of a blend"):
        RegionColor(over(source, layer(source, 1.0)).color, hash_color(1), marked_cells())
    own, made = hash_color(1), vm_color(4)
    for _ in range(MOST_REGIONS):
        made = RegionColor(made, own, marked_cells())
    field = field_of(SPACES["box"], 3, color=made)
    assert RadianceField.restore(field.describe(), field.arrays()).color.depth == MOST_REGIONS
    with pytest.raises(InvalidValue, match="101 stacked regions"):
        RegionColor(made, own, marked_cells())


def test_an_empty_patch_and_one_of_another_shape_are_refused():
    for wrong in (np.zeros((4, 4, 4), bool), np.ones((4, 4, 5), bool), np.ones((4, 4, 4))):
        with pytest.raises(InvalidValue, match="marked cells"):
            RegionColor(vm_color(4), hash_color(1), wrong)
