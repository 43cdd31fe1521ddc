"""Fewer ranks: as near as so few can be, where something is seen."""

import itertools

import numpy as np
import pytest

from stylerf.fields.occupancy_grid import OccupancyGrid
from stylerf.fields.rank_truncation import EMPTY, best_ranks, best_seen_ranks, texel_weights
from stylerf.fields.vm import VmColor, VmDensity, split_table
from stylerf.geometry.spherical_harmonics import harmonics
from stylerf.kernels.cpu.ray_samples import ShadingPoints

SIZE = np.array([7, 9, 11])
EVERYWHERE = OccupancyGrid(4)  # of a new grid every cell is occupied


def factors(seed: int, plane: int = 40, line: int = 9, rank: int = 16) -> tuple[np.ndarray, np.ndarray]:
    generator = np.random.default_rng(seed)
    return tuple(generator.normal(size=(n, rank)).astype(np.float32) for n in (plane, line))


def test_no_fewer_ranks_come_nearer():
    plane, line = factors(0)
    strengths = np.linalg.svd(plane.astype(np.float64) @ line.T.astype(np.float64))[1]
    for rank in (1, 3, 8):
        new_plane, new_line = best_ranks(plane, line, (np.ones(40), np.ones(9)), rank)
        assert new_plane.shape == (40, rank) and new_line.shape == (9, rank)
        error = np.linalg.norm(plane @ line.T - new_plane @ new_line.T)
        assert error == pytest.approx(np.sqrt((strengths[rank:] ** 2).sum()), rel=1e-4)


def test_what_lies_where_nothing_is_does_not_count():
    """Four ranks hold what is seen exactly, however much noise lies in the rows that weigh nothing."""
    plane, line = factors(1)
    seen = np.arange(40) < 20
    plane[:20, 4:] = 0
    weights = np.where(seen, 1.0, EMPTY), np.ones(9)
    new_plane, new_line = best_ranks(plane, line, weights, 4)
    np.testing.assert_allclose((new_plane @ new_line.T)[seen], (plane @ line.T)[seen], atol=1e-3)
    blind = np.ones(40), np.ones(9)
    new_plane, new_line = best_ranks(plane, line, blind, 4)
    assert np.abs((new_plane @ new_line.T)[seen] - (plane @ line.T)[seen]).max() > 0.1


UNWEIGHTED = np.ones(40), np.ones(9)


def seen(plane: np.ndarray, line: np.ndarray, head: np.ndarray) -> np.ndarray:
    """What a linear head makes of the products, [n, k, outputs]."""
    return np.einsum("nr,kr,or->nko", *(factor.astype(np.float64) for factor in (plane, line, head)))


def head_of(outputs: int, rank: int) -> np.ndarray:
    return np.random.default_rng(12).normal(size=(outputs, rank)).astype(np.float32)


def test_ranks_that_the_head_does_not_look_at_cost_nothing():
    plane, line = factors(2, rank=6)
    head = head_of(12, 6)
    head[:, [1, 4]] = 0
    fewer = best_seen_ranks(plane, line, UNWEIGHTED, head, 4)
    assert [f.shape for f in fewer] == [(40, 4), (9, 4), (12, 4)]
    np.testing.assert_allclose(seen(*fewer), seen(plane, line, head), atol=1e-4)


def test_ranks_that_say_the_same_become_one():
    """Eight products that are four, each split in two: no choice among the eight would do."""
    plane, line = factors(3, rank=4)
    head, share = head_of(12, 4), np.array([0.5, 0.3, 0.6, 0.4], np.float32)
    doubled = np.concatenate([plane * share, plane * (1 - share)], axis=1)
    fewer = best_seen_ranks(doubled, np.tile(line, 2), UNWEIGHTED, np.tile(head, 2), 4)
    np.testing.assert_allclose(seen(*fewer), seen(plane, line, head), atol=1e-4)


def test_fewer_ranks_come_nearer_than_any_chosen_of_the_old():
    plane, line = factors(4, rank=6)
    head = head_of(3, 6)
    whole = seen(plane, line, head)
    fewer = np.linalg.norm(seen(*best_seen_ranks(plane, line, UNWEIGHTED, head, 3)) - whole)
    chosen = [list(kept) for kept in itertools.combinations(range(6), 3)]
    left = [np.linalg.norm(seen(plane[:, kept], line[:, kept], head[:, kept]) - whole) for kept in chosen]
    assert fewer < 0.95 * min(left)


def test_what_is_seen_where_nothing_is_does_not_count():
    plane, line = factors(5, rank=8)
    head = head_of(12, 8)
    there = np.arange(40) < 20
    plane[:20, 4:] = 0  # four ranks hold only what lies where nothing is
    plane[20:] *= 10
    fewer = best_seen_ranks(plane, line, (np.where(there, 1.0, EMPTY), np.ones(9)), head, 4)
    assert np.abs((seen(*fewer) - seen(plane, line, head))[there]).max() < 0.05
    blind = best_seen_ranks(plane, line, UNWEIGHTED, head, 4)
    assert np.abs((seen(*blind) - seen(plane, line, head))[there]).max() > 0.5


def test_factors_stay_in_proportion():
    """Planes, lines and heads are taught at rates of their own: none may take on the size of another."""
    plane, line = factors(6)
    head = head_of(12, 16)
    fewer = best_seen_ranks(100 * plane, line, UNWEIGHTED, 0.01 * head, 8)
    lengths = [
        np.linalg.norm(f, axis=0).mean() / np.linalg.norm(old, axis=0).mean()
        for f, old in zip(fewer, (100 * plane, line, 0.01 * head))
    ]
    assert max(lengths) < 1.5 * min(lengths)
    new_plane, new_line = best_ranks(100 * plane, 0.01 * line, UNWEIGHTED, 8)
    assert 2000 < np.linalg.norm(new_plane) / np.linalg.norm(new_line) < 60000


def test_texels_weigh_what_lies_along_their_columns():
    """One occupied cell: on each plane and line the texels in its shadow, found by asking cell by cell."""
    occupancy, there = OccupancyGrid(4), (0, 1, 3)
    occupied = np.zeros((4, 4, 4), bool)
    occupied[there] = True
    occupancy.set_occupied(occupied)
    for m, (plane, line) in enumerate(texel_weights(occupancy, SIZE)):
        a, b = (m + 1) % 3, (m + 2) % 3
        plane = plane.reshape(SIZE[a], SIZE[b])
        for (i, j), weight in np.ndenumerate(plane):
            within = [min(int(k * 4 / (SIZE[axis] - 1)), 3) == there[axis] for k, axis in ((i, a), (j, b))]
            assert weight == pytest.approx(0.5 if all(within) else EMPTY)
        assert (line > EMPTY).sum() == sum(min(int(k * 4 / (SIZE[m] - 1)), 3) == there[m] for k in range(SIZE[m]))


def points(count: int = 200) -> np.ndarray:
    return np.random.default_rng(7).random((count, 3), dtype=np.float32)


def test_a_density_keeps_what_eight_of_its_ranks_hold():
    made = VmDensity.create(np.array([12, 13, 14]), 16, np.random.default_rng(3))
    for line in split_table(made.table, made.size, 16)[1]:
        line[:, 8:] = 0
    after = made.narrowed(8, EVERYWHERE)
    assert after.rank == 8 and len(after.values) < 0.6 * len(made.values)
    np.testing.assert_allclose(after.sigma(points(), 1), made.sigma(points(), 1), rtol=1e-4)


def test_a_line_of_fewer_vertices_than_ranks_is_held_exactly():
    made = VmDensity.create(SIZE, 16, np.random.default_rng(3))  # its shortest line has seven
    after = made.narrowed(12, EVERYWHERE)
    np.testing.assert_allclose(after.sigma(points(), 1), made.sigma(points(), 1), rtol=1e-4)


def colors_of(made: VmColor) -> np.ndarray:
    x, directions = points(), np.random.default_rng(8).normal(size=(200, 3)).astype(np.float32)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    starts = np.arange(200, dtype=np.int64)
    weights = np.ones(200, np.float32)
    seen = ShadingPoints(starts, starts + 1, x, weights)
    return made.colors(seen, harmonics(directions, made.degree), 1)


def test_a_color_loses_the_ranks_of_which_nothing_is_seen():
    made = VmColor.create(SIZE, 24, 1, np.random.default_rng(5))
    silent = np.random.default_rng(6).permutation(24)[:16]
    for line in split_table(made.table, SIZE, 24)[1]:
        line[:, silent] = 0
    after = made.narrowed(8, EVERYWHERE)
    assert after.rank == 8 and after.degree == 1
    np.testing.assert_allclose(colors_of(after), colors_of(made), atol=1e-5)
