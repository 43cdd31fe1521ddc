"""Walking rays: positions, lengths and weights against the oracle and a slow float64 walk; edges."""

import numpy as np
import pytest
import torch

from stylerf.fields.marching import MarchInputs, displacement_arrays, occupancy_arrays, space_arrays
from stylerf.fields.occupancy_grid import OccupancyGrid
from stylerf.fields.vm import VmDensity
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.kernels.cpu.march import OPTICAL_SCALE
from stylerf.kernels.cpu.ray_samples import MarchSettings, Rays
from tests.stylerf.kernels import torch_reference
from tests.stylerf.kernels.cpu.warping import warp_points
from tests.stylerf.small import (
    SPACES,
    Packed,
    close,
    density,
    displacement_grid,
    float64,
    occupied,
    points_on,
    rays_into,
)

STEP = 1 / 24
UNIT_BOX = SpaceWarp.box([0, 0, 0], [1, 1, 1])


def march(
    made,
    space,
    rays,
    *,
    step=STEP,
    occupancy=None,
    moved=None,
    samples_per_ray=256,
    min_transmittance=1e-3,
    opaque_background=False,
    threads=1,
):
    settings = MarchSettings(np.float32(step), samples_per_ray, np.float32(min_transmittance), opaque_background)
    grids = occupancy_arrays(occupancy or occupied()), displacement_arrays(moved)
    return made.march(rays, MarchInputs(space_arrays(space), *grids, settings, threads))


def even_fog(raw: float) -> VmDensity:
    """The same raw density everywhere."""
    made = density(0, size=(2, 2, 2))
    made.values[:] = 0
    made.values[-1] = np.log(raw)
    return made


def along_x(count=1, y=0.5, z=0.5, origin=-1.0, jitter=0.5) -> Rays:
    origins = np.tile(np.float32([origin, y, z]), (count, 1))
    ways = np.tile(np.float32([1, 0, 0]), (count, 1))
    return Rays.of(origins, ways, 0.0, np.full(count, jitter, np.float32))


# -- the warp -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", SPACES)
def test_warped_points_and_jacobians_equal_the_oracle(kind):
    world = np.random.default_rng(1).normal(scale=3, size=(300, 3)).astype(np.float32)
    if kind == "frustum":
        world[:, 2] = np.abs(world[:, 2]) + 0.6  # in front of half the near plane, where it is clamped
    found, jacobians = np.empty_like(world), np.empty(len(world), np.float32)
    warp_points(space_arrays(SPACES[kind]), world, 2, found, jacobians)
    np.testing.assert_allclose(found, torch_reference.warp(SPACES[kind], float64(world)), atol=1e-6)
    np.testing.assert_allclose(jacobians, torch_reference.density_jacobian(SPACES[kind], float64(world)), rtol=1e-5)


# -- samples --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("displaced", [False, True])
@pytest.mark.parametrize("kind", SPACES)
def test_every_sample_equals_the_oracle_at_its_distance(kind, displaced):
    space, made, rays = SPACES[kind], density(3, shift=-4.5), rays_into(SPACES[kind], 60, 4)
    moved = displacement_grid(5) if displaced else None
    packed = Packed.of(march(made, space, rays, moved=moved, opaque_background=kind != "box"))
    where, ways = points_on(rays, packed)
    x = torch_reference.warp(space, where)
    length = (
        STEP
        / torch_reference.speed(space, where, ways)
        * torch_reference.density_jacobian(space, where)
        * float(OPTICAL_SCALE)
    )
    end = packed.background
    assert bool(end.any()) == (kind != "box")
    # At m half-boxes from the middle a contraction's speed is a difference of terms 2 m times as large.
    close(packed.deltas[~end], length[~end], 1e-3 if kind == "contraction" else 2e-5)
    if displaced:
        x = torch.where(end[:, None], x, torch_reference.displaced(float64(moved), x))
    # A thousand units away a float32 distance is off by 6e-5, and a contraction shrinks that as it goes.
    np.testing.assert_allclose(packed.x, x, atol=3e-6)
    sigma = torch_reference.vm_density(float64(made.values), made.size.tolist(), made.rank, packed.x)
    close(packed.sigma[~end], sigma[~end], 2e-6)
    assert not packed.sigma[end].any()
    weights, through = torch_reference.weights(packed.sigma, packed.deltas, packed.rays, end)
    np.testing.assert_allclose(packed.weights, weights, atol=2e-6)
    assert bool((through >= 1e-3 * (1 - 1e-4)).all())


@pytest.mark.parametrize("kind", ["box", "contraction"])
def test_distances_equal_a_slow_walk_in_float64(kind):
    space, rays = SPACES[kind], rays_into(SPACES[kind], 20, 6)
    samples = march(even_fog(1e-4), space, rays, samples_per_ray=128, step=1 / 16)
    for r in range(20):
        found = samples.t[samples.starts[r] : samples.ends[r]]
        origin, way = float64(rays.origins[r])[None], float64(rays.directions[r])[None]
        expected, t, end = [], *span(space, origin[0].numpy(), way[0].numpy())
        first = True
        while t < end and len(expected) < 128:
            step = 1 / 16 / float(torch_reference.speed(space, origin + t * way, way))
            t += step * float(rays.jitter[r]) if first else 0.0
            first = False
            step = 1 / 16 / float(torch_reference.speed(space, origin + t * way, way))
            if t < end:
                expected.append(t)
            t += step
        # The last sample may fall on either side of the end; steps in a contraction grow without bound, errors too.
        both = min(len(found), len(expected))
        assert both > 5 and abs(len(found) - len(expected)) <= 1
        np.testing.assert_allclose(found[:both], np.array(expected)[:both], rtol=2e-4 if kind != "box" else 1e-5)


@pytest.mark.parametrize("kind", ["box", "frustum"])
def test_samples_are_a_step_apart_in_the_cube_wherever_rays_are_lines_there(kind):
    space, rays, step = SPACES[kind], rays_into(SPACES[kind], 40, 6), 1 / 40
    samples = march(even_fog(1e-5), space, rays, step=step)
    for r in range(40):
        origin, way = float64(rays.origins[r]), float64(rays.directions[r])
        begin, end = span(space, origin.numpy(), way.numpy())
        t = torch.from_numpy(samples.t[samples.starts[r] : samples.ends[r]].astype(np.float64))
        places = torch_reference.warp_open(space, origin + torch.cat([t.new_tensor([begin, end]), t])[:, None] * way)
        along = (places[2:] - places[0]).abs().amax(1)
        steps = torch.arange(len(t)) + float(rays.jitter[r])
        np.testing.assert_allclose(along, step * steps, atol=3e-6)
        # As many as fit before the end of the ray.
        length = float((places[1] - places[0]).abs().max())
        assert len(t) > 8 and len(t) == pytest.approx(length / step - float(rays.jitter[r]), abs=1.01)


def span(space: SpaceWarp, origin: np.ndarray, way: np.ndarray) -> tuple[float, float]:
    if space.kind != "box":
        return space.near, space.far
    low, extent = np.array(space.parameters[:3]), 1 / np.array(space.parameters[3:6])
    sides = np.stack([(low - origin) / way, (low + extent - origin) / way])
    return max(0.0, sides.min(0).max()), sides.max(0).min()


def test_a_slab_of_even_fog_is_as_opaque_as_in_closed_form():
    samples = march(even_fog(0.02), UNIT_BOX, along_x(3), step=1 / 50, min_transmittance=0.0)
    alpha = [samples.weights[a:b].sum() for a, b in zip(samples.starts, samples.ends)]
    np.testing.assert_allclose(alpha, 1 - np.exp(-0.02 * 100 * 1.0), rtol=1e-5)
    # Fifty steps from the middle of the first: t = 1.01, 1.03 ...
    np.testing.assert_allclose(samples.t[:50], 1.01 + 0.02 * np.arange(50), rtol=1e-5)
    assert samples.ends[0] - samples.starts[0] == 50


# -- edges ----------------------------------------------------------------------------------------------------------


def test_rays_that_miss_the_box_or_have_no_length_have_no_samples():
    rays = along_x(7)
    rays.origins[0, 1] = 1.5  # parallel to the box, outside
    rays.origins[1, 0], rays.origins[2, 0] = 2.0, 1.0  # behind the ray; at its far side
    rays.directions[3] = np.float32([0.6, 0.8, 0])  # passes by
    rays.near[4] = 2.5  # begins behind the box
    rays.origins[5, 1] = 0.0  # along the box's side: inside, at y = 0 exactly
    samples = march(even_fog(0.1), UNIT_BOX, rays, min_transmittance=0.0)
    counts = samples.ends - samples.starts
    assert counts.tolist() == [0, 0, 0, 0, 0, 24, 24]
    assert not samples.x[samples.starts[5] : samples.ends[5], 1].any()
    nothing = march(even_fog(0.1), UNIT_BOX, Rays.of(np.empty((0, 3), np.float32), np.empty((0, 3), np.float32), 0.0))
    assert nothing.total == 0


def test_samples_on_the_very_sides_are_requested_at_zero_and_one():
    rays = along_x(2, y=1.0, z=1.0, jitter=0.0)
    made = density(8)
    samples = march(made, UNIT_BOX, rays, min_transmittance=0.0)
    x = samples.x[samples.starts[0] : samples.ends[0]]
    assert x[0].tolist() == [0, 1, 1] and bool((x[:, 1:] == 1).all()) and x[-1, 0] > 1 - 1.1 * STEP
    expected = torch_reference.vm_density(float64(made.values), made.size.tolist(), made.rank, float64(x))
    close(samples.sigma[: len(x)], expected, 2e-6)
    corner = np.array([[0, 0, 0], [1, 1, 1], [1, 0, 1], [0, 1, 0]], np.float32)
    expected = torch_reference.vm_density(float64(made.values), made.size.tolist(), made.rank, float64(corner))
    close(made.sigma(corner, 2), expected, 2e-6)


def test_an_opaque_ray_ends_at_the_sample_that_stops_it():
    samples = march(even_fog(100.0), UNIT_BOX, along_x(1))  # a step is exp(-100 * 100 / 24) clear
    assert samples.ends[0] - samples.starts[0] == 1 and samples.weights[0] == 1
    thin = march(even_fog(1.0), UNIT_BOX, along_x(1), min_transmittance=1e-3)  # 4.17 a step: under 1e-3 after two
    assert thin.ends[0] - thin.starts[0] == 2
    whole = march(even_fog(1.0), UNIT_BOX, along_x(1), min_transmittance=0.0)
    assert whole.ends[0] - whole.starts[0] == 24
    assert np.array_equal(whole.weights[:2], thin.weights[:2])


def test_one_sample_rays():
    rays = along_x(2)
    rays.origins[0] = 1 - 0.6 * STEP, 0.5, 0.5  # room for one step from inside the box
    samples = march(even_fog(0.5), UNIT_BOX, rays, samples_per_ray=1)
    assert (samples.ends - samples.starts).tolist() == [1, 1]
    np.testing.assert_allclose(samples.weights[samples.starts], 1 - np.exp(-0.5 * 100 * STEP), rtol=1e-5)
    assert samples.t[samples.starts[0]] == pytest.approx(STEP / 2)


@pytest.mark.parametrize("kind", ["contraction", "frustum"])
def test_captures_end_in_an_opaque_background(kind):
    space, rays = SPACES[kind], rays_into(SPACES[kind], 30, 9)
    empty = OccupancyGrid(8)
    empty.set_occupied(np.zeros(8**3, bool))
    for occupancy, count in ((empty, 1), (occupied(), None)):
        packed = Packed.of(
            march(even_fog(1e-5), space, rays, occupancy=occupancy, opaque_background=True, samples_per_ray=512)
        )
        total = torch.zeros(30, dtype=torch.float64).index_add(0, packed.rays, packed.weights)
        np.testing.assert_allclose(total, 1, atol=1e-5)
        assert bool((torch.bincount(packed.rays[packed.background], minlength=30) == 1).all())
        assert bool((packed.t[packed.background] == space.far).all())
        if count:
            assert len(packed.rays) == 30 and bool((packed.weights == 1).all())
    opaque = Packed.of(march(even_fog(1e3), space, rays, opaque_background=True))
    assert not opaque.background.any() and len(opaque.rays) == 30  # stopped at once: nothing left to take


def test_rays_that_leave_a_frustum_end_where_they_leave_it():
    space = SPACES["frustum"]
    bx, by, near = space.parameters[:3]
    origins = np.float32([[0, 0, 5], [0, 0, 5], [0, 0, 5], [0, 0, 0.4], [0.5, 0, -3]]) * near
    ways = np.float32([[0, 0, -1], [1, 0, 0], [0, -1, 0], [0, 0, -1], [0, 0.1, -1]])
    rays = Rays.of(origins, ways, 0.0, np.full(5, 0.5, np.float32))
    samples = march(even_fog(1e-5), space, rays, samples_per_ray=512)
    counts = samples.ends - samples.starts
    leaves = np.array([4.5, 2 * bx * 5, 2 * by * 5]) * near
    assert counts[:3].min() > 5 and counts[3:].tolist() == [0, 0]
    last = samples.t[samples.ends[:3] - 1]
    assert (last < leaves).all() and (last > 0.8 * leaves).all()


def test_rays_that_enter_a_frustum_begin_where_they_enter_it():
    space = SPACES["frustum"]
    bx, by, near = space.parameters[:3]
    origins = np.float32([[5, 0, 2], [0, -6, 2], [0, 0, -3]]) * near
    ways = np.float32([[-1, 0, 0], [0, 1, 0], [0, 0, 1]])
    enters = np.array([5 - 2 * bx * 2, 6 - 2 * by * 2, 3.5]) * near
    samples = march(even_fog(1e-5), space, Rays.of(origins, ways, 0.0, np.zeros(3, np.float32)), samples_per_ray=512)
    assert (samples.ends - samples.starts).min() > 5
    np.testing.assert_allclose(samples.t[samples.starts], enters, rtol=1e-5)


def test_an_empty_grid_gives_no_sample_in_an_open_box():
    empty = OccupancyGrid(8)
    empty.set_occupied(np.zeros(8**3, bool))
    samples = march(even_fog(1.0), UNIT_BOX, rays_into(UNIT_BOX, 20, 0), occupancy=empty)
    assert samples.total == 0


@pytest.mark.parametrize("kind", SPACES)
def test_threads_do_not_change_a_bit_of_a_ray(kind):
    space, made, rays = SPACES[kind], density(3), rays_into(SPACES[kind], 31, 10)
    moved = displacement_grid(5)
    one, three = (march(made, space, rays, moved=moved, opaque_background=kind != "box", threads=c) for c in (1, 3))
    assert not np.array_equal(one.starts, three.starts)
    a, b = Packed.of(one), Packed.of(three)
    for name in ("rays", "t", "deltas", "x", "sigma", "weights"):
        assert torch.equal(getattr(a, name), getattr(b, name)), name


# -- displacement ---------------------------------------------------------------------------------------------------


def test_displaced_positions_are_clamped_at_the_sides():
    moved = np.zeros((3, 3, 3, 3), np.float32)
    moved[..., 0], moved[..., 1] = 0.75, -0.75
    samples = march(even_fog(0.01), UNIT_BOX, along_x(1), moved=moved, min_transmittance=0.0)
    x = samples.x[: samples.ends[0]]
    expected = np.clip((np.arange(24) + 0.5) / 24 + 0.75, 0, 1)
    np.testing.assert_allclose(x[:, 0], expected, atol=1e-6)
    assert not x[:, 1].any() and (x[:, 2] == 0.5).all() and (x[6:, 0] == 1).all()
