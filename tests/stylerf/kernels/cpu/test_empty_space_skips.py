"""Leaping over empty space: never into what is occupied, and without a change of the result."""

import numpy as np
import pytest
import torch

from stylerf.fields.occupancy_grid import OccupancyGrid
from stylerf.fields.vm import VmDensity, split_table
from stylerf.kernels.cpu.ray_samples import Rays
from tests.stylerf.kernels import torch_reference
from tests.stylerf.kernels.cpu.test_march import even_fog, march
from tests.stylerf.small import SPACES, Packed, density, float64, occupied, rays_into


def block_field(cells=16) -> tuple[VmDensity, OccupancyGrid]:
    """Two dense blocks in the emptiest space there is (exp(-15)), and the cells they reach into."""
    size = 2 * cells + 1
    made = density(0, size=(size,) * 3)
    made.values[:] = 0
    made.values[-1] = -15
    planes, lines = split_table(made.table, made.size, made.rank)
    solid = np.zeros((size,) * 3, bool)
    for r, (x, y, z) in enumerate((((6, 10), (12, 20), (8, 14)), ((22, 27), (5, 9), (20, 26)))):
        planes[0][y[0] : y[1], z[0] : z[1], r] = 16.0  # plane 0 lies over y and z, its line along x
        lines[0][x[0] : x[1], r] = 1
        solid[x[0] : x[1], y[0] : y[1], z[0] : z[1]] = True
    full = np.zeros((cells,) * 3, bool)
    for place in np.argwhere(solid):  # a vertex is felt within one vertex' distance, half a cell, on all sides
        full[tuple(slice(max(0, (v - 1) // 2), v // 2 + 1) for v in place)] = True
    occupancy = OccupancyGrid(cells)
    occupancy.set_occupied(full.ravel())
    return made, occupancy


def sums(samples, values: np.ndarray) -> np.ndarray:
    return np.array([samples.weights[a:b] @ values[a:b] for a, b in zip(samples.starts, samples.ends)])


def test_leaps_in_a_box_do_not_change_the_result():
    made, exact = block_field()
    assert 0 < exact.share < 0.2
    space, rays = SPACES["box"], rays_into(SPACES["box"], 300, 12)
    plain = march(made, space, rays, step=1 / 64, occupancy=occupied(16))
    leaping = march(made, space, rays, step=1 / 64, occupancy=exact)
    assert leaping.total < plain.total / 4
    before, after = sums(plain, np.ones_like(plain.t)), sums(leaping, np.ones_like(leaping.t))
    assert (before > 0.5).sum() > 15 and (before < 1e-3).sum() > 15
    # Empty space weighs 100 exp(-15) a cube's width, 3e-5; rounding moves samples in the blocks' soft rims as much.
    np.testing.assert_allclose(after, before, atol=3e-4)
    np.testing.assert_allclose(sums(leaping, leaping.t), sums(plain, plain.t), atol=1e-3)


def clumps(cells: int, seed: int) -> np.ndarray:
    """Occupied cells [cells^3]: a few balls and as many single cells."""
    generator = np.random.default_rng(seed)
    centers = (np.indices((cells,) * 3).reshape(3, -1).T + 0.5) / cells
    full = np.zeros(cells**3, bool)
    for middle, radius in zip(generator.random((6, 3)), generator.uniform(0.05, 0.2, 6)):
        full |= np.linalg.norm(centers - middle, axis=1) < radius
    full[generator.integers(0, cells**3, 6)] = True
    return full


def stays(places: torch.Tensor, full: np.ndarray, cells: int) -> list[torch.Tensor]:
    """The stretches of a ray's places [n, 3], in the cube, that lie in occupied cells."""
    cell = (places.clamp(0, 1 - 1e-9) * cells).long()
    hit = full[(cell[:, 0] * cells + cell[:, 1]) * cells + cell[:, 2]]
    edges = np.flatnonzero(np.diff(np.concatenate([[0], hit, [0]]).astype(int)))
    return [places[a:b] for a, b in zip(edges[::2], edges[1::2])]


@pytest.mark.parametrize("cells", [8, 32])
@pytest.mark.parametrize("kind", SPACES)
def test_no_skip_passes_into_an_occupied_cell(kind, cells):
    """A stay of more than a step in occupied cells is sampled, all of it within a step of a sample."""
    space, rays, step = SPACES[kind], rays_into(SPACES[kind], 400, 13), 1 / 64
    full, occupancy = clumps(cells, 14), OccupancyGrid(cells)
    occupancy.set_occupied(full)
    assert 0.01 < occupancy.share < 0.2
    packed = Packed.of(march(even_fog(1e-6), space, rays, step=step, occupancy=occupancy, samples_per_ray=512))
    t = torch.from_numpy(np.linspace(0, 6, 4000) if kind == "box" else np.geomspace(space.near, 200, 4000))
    # A ray into a contraction's middle grows faster while it takes a step: at m = 3, by half.
    bound, checked = (1.5 if kind == "contraction" else 1.02) * step, 0
    for r in range(400):
        origin, way = float64(rays.origins[r]), float64(rays.directions[r])
        places = torch_reference.warp_open(space, origin + t[:, None] * way)
        places = places[((places >= 0) & (places <= 1)).all(1)]
        samples = torch_reference.warp_open(space, origin + packed.t[packed.rays == r][:, None] * way)
        for stay in stays(places, full, cells):
            # The first place and the last may be left out: half a step before the first sample, what is left behind.
            if float((stay[-1] - stay[0]).abs().max()) > bound and not torch.equal(stay[0], places[0]):
                away = (stay[:, None] - samples[None]).abs().amax(2).amin(1)
                assert float(away.max()) < bound
                checked += 1
    assert checked > 60


@pytest.mark.parametrize("forward", [-1.0, -0.3])
def test_rays_that_look_back_in_a_frustum_do_not_skip_its_surfaces(forward):
    """Towards the near plane the cube goes by with 1/z^2: a skip at the speed of its first step would pass a wall."""
    space, cells, generator = SPACES["frustum"], 64, np.random.default_rng(3)
    wall = np.zeros((cells,) * 3, bool)
    wall[..., 8:10] = True
    skipping, walking = OccupancyGrid(cells), OccupancyGrid(cells)
    for occupancy in (skipping, walking):
        occupancy.set_occupied(wall.ravel())
    walking.distances = np.minimum(walking.distances, 1)
    ways = np.stack([*generator.uniform(-0.3, 0.3, (2, 200)), np.full(200, forward)], 1)
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    places = np.tile(np.float32([0.1, -0.2, 4]), (200, 1))
    rays = Rays.of(places, ways.astype(np.float32), 0.0)
    found, wanted = (march(even_fog(10.0), space, rays, step=1 / 128, occupancy=one) for one in (skipping, walking))
    found, wanted = (sums(one, np.ones_like(one.t)) for one in (found, wanted))
    assert (wanted > 0.5).sum() > 50
    assert (np.abs(found - wanted) < 0.1).mean() > 0.98  # the others graze the wall where they leave the frustum


@pytest.mark.parametrize("zero", [0.0, -0.0])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_rays_along_a_side_of_a_box_skip_as_their_neighbors_do(axis, zero):
    """A ray that does not move along an axis at all never leaves its cells on that axis."""
    space, step, cells = SPACES["box"], 1 / 64, 16
    occupancy = OccupancyGrid(cells)
    occupancy.set_occupied(clumps(cells, 14))
    rays = rays_into(space, 400, 13, jitter=False)
    rays.directions[:, axis] = zero
    rays.directions[:200, (axis + 1) % 3] = zero
    rays.directions[:] /= np.linalg.norm(rays.directions, axis=1, keepdims=True)
    beside = Rays(rays.origins, rays.directions.copy(), rays.jitter, rays.near)
    beside.directions[beside.directions == 0] = 1e-7
    found, wanted = (march(even_fog(0.05), space, one, step=step, occupancy=occupancy) for one in (rays, beside))
    found, wanted = (sums(one, np.ones_like(one.t)) for one in (found, wanted))
    assert (wanted > 0.01).sum() > 20
    assert (np.abs(found - wanted) < 1e-3).mean() > 0.97  # the others graze a cell, or a side of the box


def test_a_step_that_is_lost_in_a_far_cameras_distance_ends_the_ray():
    """In float32 a thousandth cannot be added to a distance of 1e5, and beside an occupied cell a skip is no more."""
    space, cells = SPACES["box"], 24
    occupancy = OccupancyGrid(cells)
    occupancy.set_occupied(clumps(cells, 14))
    rays = rays_into(space, 400, 3)
    away = Rays(rays.origins - 1e5 * rays.directions, rays.directions, rays.jitter, rays.near)
    found = Packed.of(march(even_fog(1e-6), space, away, step=1e-3, occupancy=occupancy))
    assert len(found.t) and bool(found.t.isfinite().all())
