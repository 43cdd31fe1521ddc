"""Gradients of a deformation: densities to positions, positions to the displacement grid, against the oracle."""

import numpy as np
import pytest

from stylerf.fields.deformation import displacement_gradient
from stylerf.fields.marching import displacement_arrays, occupancy_arrays
from stylerf.fields.occupancy_grid import OccupancyGrid
from stylerf.kernels.cpu.deformation import displaced_cells, mark_cells
from stylerf.kernels.cpu.march import OPTICAL_SCALE
from stylerf.kernels.cpu.ray_samples import Rays
from tests.stylerf.kernels import torch_reference
from tests.stylerf.kernels.cpu.test_march import STEP, even_fog, march
from tests.stylerf.kernels.cpu.test_vm import owned, samples
from tests.stylerf.small import (
    SPACES,
    Packed,
    close,
    density,
    displacement_grid,
    float64,
    points_on,
    rays_into,
)


def test_density_position_gradient_of_an_exponential_slope():
    """A line that rises linearly along z times a plane of ones: d sigma / dz = sigma * slope everywhere."""
    made, s = density(3), samples()
    made.values[:-1] = 0
    plane = made.table.size - (7 + 6 + 8) * made.rank
    z = 2  # plane 2 lies over x and y, its line along z
    made.values[(6 * 8 + 8 * 7) * made.rank : plane : made.rank] = 1
    made.values[plane + (7 + 6) * made.rank : plane + (7 + 6 + 8) * made.rank : made.rank] = np.linspace(0, 3, 8)
    s = s._replace(sigma=made.sigma(s.x, 1))
    np.testing.assert_allclose(s.sigma, np.exp(-2 + 3 * s.x[:, z]), rtol=3e-6)
    out = np.zeros(s.x.shape, np.float32)
    made.add_position_gradients(s, np.ones(len(s.x), np.float32), out, 1)
    at = owned(s)
    np.testing.assert_allclose(out[at, z], 3 * s.sigma[at], rtol=1e-5)
    np.testing.assert_allclose(out[at, :z], 0, atol=1e-5)


@pytest.mark.parametrize("kind", SPACES)
def test_displacement_gradient_equals_the_oracle(kind):
    space, rays, moved = SPACES[kind], rays_into(SPACES[kind], 25, 4), displacement_grid(5, reach=0.15)
    found = march(density(3, shift=-4.5), space, rays, moved=moved, opaque_background=kind != "box", threads=2)
    packed = Packed.of(found)
    gradients = np.zeros(found.x.shape, np.float32)
    gradients[packed.at] = np.random.default_rng(6).normal(size=(len(packed.at), 3))
    grid = float64(moved).requires_grad_()
    x = torch_reference.displaced(grid, torch_reference.warp(space, points_on(rays, packed)[0]))
    moves = ~packed.background  # the background is not displaced
    assert bool(moves.all()) == (kind == "box")
    sides = ((x == 0) | (x == 1))[moves].any(1).sum()
    assert 10 < int(sides) < len(packed.at) / 2
    (x * float64(gradients[packed.at]))[moves].sum().backward()
    for threads in (1, 2, 3):
        to = np.ones((threads, moved.size), np.float32)
        displacement_gradient(space, rays, found, gradients, len(moved), to)
        close((to.astype(np.float64) - 1).sum(0), grid.grad.flatten(), 2e-5)


def test_one_sample_spreads_its_gradient_over_eight_vertices():
    space = SPACES["box"]
    origin = np.float32([[0.1, 0.05, 0.1]])
    rays = Rays.of(origin, np.float32([[1, 0, 0]]), 0.0, np.zeros(1, np.float32))
    moved = np.zeros((2, 2, 2, 3), np.float32)
    found = march(even_fog(1e5), space, rays, moved=moved)  # opaque at once: a single sample, at the origin
    assert found.total == 1 and found.t[0] == 0
    np.testing.assert_allclose(found.x[0], [0.5, 0.5, 0.5], atol=1e-6)
    assert found.deltas[0] == pytest.approx(STEP * 2.2 * np.mean([1 / 2.2, 1 / 1.7, 1 / 1.2]) * OPTICAL_SCALE, rel=1e-5)
    gradients = np.zeros(found.x.shape, np.float32)
    gradients[0] = 8, -16, 24
    to = np.zeros((1, 24), np.float32)
    displacement_gradient(space, rays, found, gradients, 2, to)
    np.testing.assert_allclose(to.reshape(8, 3), np.tile([1, -2, 3], (8, 1)), rtol=1e-5)
    found.x[0, 1] = 1.0  # held by the cube's side: that coordinate does not move with the grid
    to[:] = 0
    displacement_gradient(space, rays, found, gradients, 2, to)
    np.testing.assert_allclose(to.reshape(8, 3), np.tile([1, 0, 3], (8, 1)), rtol=1e-5)


@pytest.mark.parametrize("reach", [0.05, 0.3])
def test_cells_are_occupied_if_any_of_27_points_moves_into_occupied_ones(reach):
    cells, moved = 7, displacement_grid(2, cells=4, reach=reach)
    full = np.random.default_rng(3).random(cells**3) < 0.03
    occupancy = OccupancyGrid(cells)
    occupancy.set_occupied(full)
    found = np.zeros(cells**3, np.bool_)
    displaced_cells(occupancy_arrays(occupancy), displacement_arrays(moved), cells, found)
    corner = np.stack(np.unravel_index(np.arange(cells**3), (cells,) * 3), 1)
    within = np.array(list(np.ndindex(3, 3, 3))) * 0.48 + 0.02  # just inside the sides, and the middle
    points = (corner[:, None] + within[None]) / cells
    x = torch_reference.displaced(float64(moved), float64(points.reshape(-1, 3))).numpy()
    place = np.minimum((x * cells).astype(int), cells - 1)
    expected = full[(place[:, 0] * cells + place[:, 1]) * cells + place[:, 2]].reshape(-1, 27).any(1)
    assert np.array_equal(found, expected) and 0 < found.sum() < cells**3 and not np.array_equal(found, full)


def test_marked_cells_are_those_of_samples_that_show():
    s, seen = samples(3), np.zeros((5, 5, 5), np.bool_)
    shown = np.random.default_rng(0).integers(0, 2, len(s.x)).astype(np.float32)
    mark_cells(s.shading_points(shown), 5, seen)
    at = owned(s)[shown[owned(s)] > 0]
    lower = np.minimum((s.x[at] * 4).astype(int), 3)  # five vertices, four cells
    expected = np.zeros((5, 5, 5), bool)
    expected[tuple(lower.T)] = True
    assert np.array_equal(seen, expected) and 5 < seen.sum() < 60
