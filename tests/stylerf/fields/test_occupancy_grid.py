"""The occupancy grid against slow loops: distances, what counts as occupied, decay, growth."""

import numpy as np
import pytest

from stylerf.fields.occupancy_grid import DENSEST, OPAQUE_STEP, OccupancyGrid


def test_distances_are_chebyshev_distances():
    cells, full = 6, np.random.default_rng(1).random(6**3) < 0.02
    made = OccupancyGrid(cells)
    made.set_occupied(full)
    places = np.stack(np.unravel_index(np.arange(cells**3), (cells,) * 3), 1)
    expected = np.abs(places[:, None] - places[full][None]).max(2).min(1)
    assert np.array_equal(made.distances, expected) and made.share == full.mean() > 0
    made.set_occupied(np.zeros(cells**3, bool))
    assert (made.distances == 255).all() and made.share == 0


def test_distances_end_at_255():
    cells = 260
    made, full = OccupancyGrid(cells), np.zeros(cells**3, bool)
    full[0] = True
    made.set_occupied(full)
    ways = np.minimum(np.arange(cells), 255).astype(np.uint8)
    expected = np.maximum(np.maximum(ways[:, None, None], ways[:, None]), ways)
    assert np.array_equal(made.distances, expected.ravel())


def test_a_cell_counts_where_a_step_would_be_a_hundredth_opaque():
    made, step = OccupancyGrid(4), 1 / 50
    bound = -np.log(1 - OPAQUE_STEP) / (100 * step)  # 1 - exp(-100 sigma step)
    highest = np.full(64, 50.0, np.float32)
    highest[:3] = bound * 1.001, bound * 0.999, 0
    made.highest = highest
    made.decide(step)
    assert (made.distances == 0).tolist() == [True, False, False] + [True] * 61


def test_a_thin_field_is_kept_where_it_is_thicker_than_its_mean():
    made = OccupancyGrid(4)
    made.highest = np.linspace(0, 1e-6, 64, dtype=np.float32)
    made.decide(1 / 50)
    assert np.array_equal(made.distances == 0, np.arange(64) >= 32)


@pytest.mark.parametrize("share", [1, 4])
def test_refreshing_keeps_a_decaying_maximum_of_the_cells_it_looks_at(share):
    made, requested = OccupancyGrid(4), []

    def rising(x):
        requested.append(x)
        return x[:, 0] + 1

    made.refresh(rising, 1 / 50, 0, 1, 0.9)
    first = made.highest.copy()
    cells = np.floor(requested[0] * 4).astype(int)
    assert np.array_equal(cells, np.stack(np.unravel_index(np.arange(64), (4, 4, 4)), 1))  # a point in every cell
    np.testing.assert_allclose(first, requested[0][:, 0] + 1)
    made.refresh(lambda x: np.full(len(x), 1.2, np.float32), 1 / 50, 3, share, 0.9)
    looked = made.highest != first
    start = int(np.random.default_rng(3).integers(share))
    index = np.arange(start, 64, share)
    assert set(np.flatnonzero(looked)) <= set(index)
    np.testing.assert_allclose(made.highest[index], np.maximum(first[index] * np.float32(0.9), 1.2), rtol=1e-6)


def test_a_finer_grid_knows_the_same():
    made = OccupancyGrid(3)
    made.highest = np.arange(27, dtype=np.float32)
    made.set_occupied(np.arange(27) % 5 == 0)
    finer = made.resized(6)
    for i, j, k in np.ndindex(6, 6, 6):
        old, new = (i // 2 * 3 + j // 2) * 3 + k // 2, (i * 6 + j) * 6 + k
        assert finer.highest[new] == made.highest[old] and (finer.distances[new] == 0) == (made.distances[old] == 0)


def test_cells_known_to_be_clear_stay_so_on_a_finer_grid():
    clear, requested = np.arange(64) % 3 == 0, []
    made = OccupancyGrid(4, clear=clear)
    assert np.array_equal(made.distances == 0, ~clear)

    def dense(x):
        requested.append(x)
        return np.full(len(x), 50, np.float32)

    made.refresh(dense, 1 / 50, 0, 1, 0.9)
    assert len(requested[0]) == (~clear).sum() and np.array_equal(made.distances == 0, ~clear)
    finer = made.resized(8)
    finer.highest[:] = 50
    finer.decide(1 / 50)
    cell = np.stack(np.unravel_index(np.arange(512), (8, 8, 8)), 1) // 2
    assert np.array_equal(finer.distances == 0, ~clear[np.ravel_multi_index(cell.T, (4, 4, 4))])


def test_a_cell_that_was_seen_however_dense_is_not_forgotten_at_once():
    """The densities of a solid may pass any number: its mark must be none of them."""
    made = OccupancyGrid(4)
    made.refresh(lambda x: np.full(len(x), 3e4, np.float32), 1 / 50, 0, 1, 0.9)
    assert np.isfinite(made.highest).all()
    made.refresh(lambda x: np.zeros(len(x), np.float32), 1 / 50, 1, 1, 0.9)
    assert np.allclose(made.highest, 0.9 * DENSEST) and (made.distances == 0).all()


@pytest.mark.parametrize("mark", [np.inf, 1e4])
def test_a_cell_that_nobody_has_looked_at_counts_until_somebody_does(mark):
    """In a file of before it holds 10,000."""
    made = OccupancyGrid(4, np.full(64, mark, np.float32))
    made.refresh(lambda x: np.full(len(x), 1e-3, np.float32), 1 / 50, 0, 4, 0.9)
    looked = np.isfinite(made.highest)
    assert looked.sum() == 16 and np.array_equal(made.distances == 0, ~looked)
    for seed in range(1, 40):
        made.refresh(lambda x: np.full(len(x), 1e-3, np.float32), 1 / 50, seed, 4, 0.9)
    assert np.isfinite(made.highest).all() and np.allclose(made.highest, 1e-3)
