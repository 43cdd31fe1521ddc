"""Regions: growth against a queue worked off cell by cell."""

from collections import deque

import numpy as np
import pytest

from stylerf.editing.edit_grid import Region, grow, marked_at, narrowest, neighbors, solid_cells
from stylerf.errors import InvalidValue
from stylerf.fields.occupancy_grid import OccupancyGrid
from stylerf.fields.radiance_field import RadianceField
from tests.stylerf.small import SPACES, occupied, vm_color

SIDE = 7


def queue_growth(start: np.ndarray, allowed: np.ndarray, most: int) -> np.ndarray:
    """LAENeRF's growth: a first-in first-out queue of cells, face neighbors appended on acceptance."""
    marked, seen, looked = start.copy(), start.copy(), 0
    queue: deque = deque()

    def push(cell):
        for axis in range(3):
            for step in (-1, 1):
                other = list(cell)
                other[axis] += step
                if 0 <= other[axis] < start.shape[0] and not seen[tuple(other)]:
                    seen[tuple(other)] = True
                    queue.append(tuple(other))

    for cell in np.argwhere(start):
        push(tuple(cell))
    while queue and looked < most:
        cell = queue.popleft()
        looked += 1
        if allowed[cell]:
            marked[cell] = True
            push(cell)
    return marked


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_growth_reaches_what_a_queue_reaches(seed):
    random = np.random.default_rng(seed)
    allowed = random.random((SIDE,) * 3) < 0.55
    start = np.zeros_like(allowed)
    start[3, 3, 3] = True
    found = grow(start, allowed, 10**6)
    np.testing.assert_array_equal(found.grown, queue_growth(start, allowed, 10**6))
    assert found.whole
    assert found.grown.sum() - 1 == sum(found.shells)


def test_limited_growth_visits_that_many_cells_shell_by_shell():
    start = np.zeros((SIDE,) * 3, bool)
    start[3, 3, 3] = True
    everywhere = np.ones_like(start)
    found = grow(start, everywhere, 10)  # a shell of six, and four of the next
    assert found.shells == [6, 4]
    assert not found.whole
    away = np.abs(np.argwhere(found.grown) - 3).sum(1)
    assert sorted(away) == [0] + [1] * 6 + [2] * 4


def test_growth_stops_at_a_neck():
    """Two blocks of 5^3 cells, joined by a long rod one cell thick: from one block growth must not reach the other."""
    allowed = np.zeros((20,) * 3, bool)
    allowed[0:5, 0:5, 0:5] = True
    allowed[5:15, 2, 2] = True
    allowed[15:20, 0:5, 0:5] = True
    start = np.zeros_like(allowed)
    start[2, 2, 2] = True
    np.testing.assert_array_equal(grow(start, allowed, 10**6).grown, allowed)
    kept = grow(start, allowed, 10**6, neck=0.3).grown
    assert kept[0:5, 0:5, 0:5].all()
    assert not kept[15:].any()


def test_what_dwindles_to_nothing_is_no_neck():
    assert narrowest([6, 18, 38, 30, 12, 3, 0], 0.5) == 7
    assert narrowest([6, 18, 38, 12, 2, 2, 12, 40], 0.5) in (4, 5)
    assert narrowest([6, 18, 38, 12, 2, 2, 12, 40], 0.0) == 8


def test_neighbors_of_a_corner_and_of_the_middle():
    assert neighbors(np.array([0]), 3).tolist() == [1, 3, 9]
    assert neighbors(np.array([13]), 3).tolist() == [4, 10, 12, 14, 16, 22]


def test_solid_cells_are_those_a_walk_across_which_is_opaque_enough():
    """A density that is even in a half of the cube and nearly nothing in the other."""
    space = SPACES["box"]
    field = RadianceField(space, _half_full(), vm_color(2), occupied(), 0.02)
    found = solid_cells(field, 8, 2, 0.02)
    assert found[:3].all()
    assert not found[5:].any()


@pytest.mark.parametrize("at", [4, 5])
def test_a_cell_over_several_of_the_occupancy_is_solid_for_any_of_them(at):
    occupancy, slab = OccupancyGrid(16), np.zeros((16,) * 3, bool)
    slab[at] = True
    occupancy.set_occupied(slab.ravel())
    field = RadianceField(SPACES["box"], _slab(at), vm_color(2), occupancy, 0.02)
    expected = np.zeros((8,) * 3, bool)
    expected[at // 2] = True
    np.testing.assert_array_equal(solid_cells(field, 8, 2), expected)


class _slab:
    """Raw density 100 in one of sixteen layers across x."""

    def __init__(self, at: int) -> None:
        self.at = at

    def sigma(self, points, threads):
        return np.where(np.floor(points[:, 0] * 16) == self.at, 100.0, 1e-4).astype(np.float32)


class _half_full:
    """Raw density 100 where x < 1/2."""

    def sigma(self, points, threads):
        return np.where(points[:, 0] < 0.5, 100.0, 1e-4).astype(np.float32)


def test_points_outside_count_to_the_border():
    marked = marked_at(np.array([[-1.0, 0.5, 2.0]]), 4)
    assert np.argwhere(marked).tolist() == [[0, 2, 3]]


def test_grids_that_overlap_or_differ_are_refused():
    full = np.ones((3, 3, 3), bool)
    with pytest.raises(InvalidValue, match="share no cell"):
        Region(full, full)
    with pytest.raises(InvalidValue, match="grids of"):
        Region(full, np.zeros((4, 4, 4), bool))
