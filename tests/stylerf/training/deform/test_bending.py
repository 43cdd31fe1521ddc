"""Displacements beyond what is seen, and the penalty of slopes."""

import numpy as np
import pytest
import torch

from stylerf.training.deform.bending import NEIGHBORS, Extension, folding

CPU = torch.device("cpu")


def chosen(count: int, vertices: int, seed: int = 2) -> np.ndarray:
    return np.sort(np.random.default_rng(seed).choice(vertices**3, count, replace=False))


def places(vertices: int) -> np.ndarray:
    return np.stack(np.unravel_index(np.arange(vertices**3), (vertices,) * 3), -1).astype(float)


def test_given_vertices_keep_their_displacement():
    active = chosen(30, 6)
    moved = torch.randn(30, 3, generator=torch.Generator().manual_seed(0))
    np.testing.assert_allclose(Extension(active, 6, CPU).spread(moved)[active], moved, atol=1e-5)


def test_others_move_as_the_weighted_mean_of_their_neighbors():
    active, where = chosen(30, 6), places(6)
    moved = torch.randn(30, 3, generator=torch.Generator().manual_seed(0))
    found = Extension(active, 6, CPU).spread(moved)
    for vertex in set(range(6**3)) - set(active.tolist()):
        squares = np.square(where[active] - where[vertex]).sum(1)
        # Where two are equally far, either may be the last of the neighbors.
        if np.sort(squares)[NEIGHBORS - 1] < np.sort(squares)[NEIGHBORS]:
            near = np.argsort(squares)[:NEIGHBORS]
            expected = np.average(moved.numpy()[near], axis=0, weights=1 / squares[near])
            np.testing.assert_allclose(found[vertex], expected, rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("count", [1, 3, 40])
def test_gradients_are_gathered_by_the_transpose(count):
    made = Extension(chosen(count, 5), 5, CPU)
    moved = torch.randn(count, 3, dtype=torch.float64, requires_grad=True)
    towards = torch.randn(5**3, 3, dtype=torch.float64)
    (expected,) = torch.autograd.grad((made.spread(moved) * towards).sum(), moved)
    np.testing.assert_allclose(made.gathered(towards), expected, rtol=1e-5, atol=1e-7)


def test_folding_counts_what_exceeds_the_limit():
    m, everywhere = 5, torch.ones(5, 5, 5, dtype=torch.bool)
    grid = torch.zeros(m, m, m, 3)
    grid[..., 1] = 0.6 * torch.arange(m)[:, None, None] / (m - 1)  # along the first axis, slope 0.6
    assert float(folding(grid, everywhere, 0.7)) == pytest.approx(0, abs=2e-4)
    assert float(folding(grid, everywhere, 0.5)) == pytest.approx(0.1, rel=1e-3)
    apart = everywhere.clone()
    apart[::2] = False  # no two neighbors along the axis
    assert float(folding(grid, apart, 0.5)) == pytest.approx(0, abs=2e-4)
