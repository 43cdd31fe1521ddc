"""The parts of a selection: seeds that no look sees, reach, regions to combine with."""

from types import SimpleNamespace

import numpy as np
import pytest

from schemas.errors import BadInput
from stages import region_select
from stages.configs.select import SelectConfig
from stylerf.editing.edit_grid import Region
from stylerf.editing.selection import halved_lightness
from stylerf.geometry.space_warp import SpaceWarp

CELLS = 16
BOX = SpaceWarp.box([0, 0, 0], [1, 1, 1])


def looking(**more) -> SimpleNamespace:
    return SimpleNamespace(field=SimpleNamespace(space=BOX), cells=CELLS, **more)


def test_every_seed_counts_for_the_reach_however_many_there_are():
    """Forty seeds on one thing, one on another far from it."""
    points = np.concatenate([np.random.default_rng(0).uniform(0.1, 0.2, (40, 3)), [[0.8, 0.8, 0.8]]])[::-1]
    for order in (points, points[::-1], np.roll(points, 7, axis=0)):
        among = np.ones((CELLS,) * 3, bool)
        among[0] = False
        found = region_select.cells_within(looking(), order, 0.15, among)
        centers = (np.argwhere(among) + 0.5) / CELLS
        expected = (np.linalg.norm(centers[:, None] - points, axis=2) <= 0.15).any(1)
        np.testing.assert_array_equal(found[among], expected)
        assert not found[0].any() and found[13, 13, 13]


def test_a_seed_in_an_unseen_cell_takes_the_color_of_its_pixel():
    red, blue = np.float32([0.9, 0.1, 0.1]), np.float32([0.1, 0.1, 0.8])
    known, lab = np.zeros((CELLS,) * 3, bool), np.full((CELLS, CELLS, CELLS, 3), np.nan, np.float32)
    known[2, 2, 2] = True
    lab[2, 2, 2] = halved_lightness(red[None])
    photos = [np.tile(np.float32([0.5, 0.5, 0.5]), (4, 4, 1)), np.tile(blue, (4, 4, 1))]
    scene = SimpleNamespace(images=photos.__getitem__)
    here = looking(seen=SimpleNamespace(known=known, lab=lab), scene=scene, level=0.0)
    points = np.array([[2.5, 2.5, 2.5], [9.5, 2.5, 2.5]]) / CELLS
    found = region_select.Seeds(points, np.array([0, 1]), np.array([3, 7])).lab(here)
    np.testing.assert_allclose(found, halved_lightness(np.stack([red, blue])), atol=1e-4)


@pytest.mark.parametrize("order", [("union.a", "subtract.b"), ("subtract.b", "union.a")])
def test_regions_of_other_sizes_are_refused_by_both_names(order):
    def region(cells: int):
        return Region(np.ones((cells,) * 3, bool), np.zeros((cells,) * 3, bool)), BOX

    others = {"union.a": region(4), "subtract.b": region(6)}
    with pytest.raises(BadInput, match="a 4") as reported:
        region_select.cells_given(SelectConfig(union=("a",)), {role: others[role] for role in order})
    assert "b 6" in str(reported.value)
    assert region_select.cells_given(SelectConfig(union=("a",)), {"union.a": region(4)}) == 4
    with pytest.raises(BadInput, match="--cells 16"):
        region_select.cells_given(SelectConfig(union=("a",), cells=16), {"union.a": region(4)})
