"""Edges of the GPU kernels: rays that miss, end at once or find no room; the cube's corners; offsets beyond 2^31."""

import numpy as np
import pytest
import torch

from stylerf.fields.occupancy_grid import OccupancyGrid
from stylerf.fields.radiance_field import RadianceField
from stylerf.fields.vm import VmDensity
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.kernels.cpu.ray_samples import Rays
from tests.stylerf.kernels import torch_reference
from tests.stylerf.kernels.gpu.on_gpu import device_rays, on_host
from tests.stylerf.small import SPACES, Packed, close, density, float64, hash_color, occupied, rays_into

UNIT_BOX = SpaceWarp.box([0, 0, 0], [1, 1, 1])


def even_fog(raw: float) -> VmDensity:
    made = density(0, size=(2, 2, 2))
    made.values[:] = 0
    made.values[-1] = np.log(raw)
    return made


def along_x(*origins: tuple[float, float, float], jitter: float = 0.5) -> Rays:
    count = len(origins)
    ways = np.tile(np.float32([1, 0, 0]), (count, 1))
    return Rays.of(np.array(origins, np.float32), ways, 0.0, np.full(count, jitter, np.float32))


def device_field(made, device, space=UNIT_BOX, step=1 / 8, occupancy=None):
    from stylerf.fields.gpu.field import GpuField

    return GpuField(RadianceField(space, made, hash_color(1), occupancy or occupied(), step), device)


def test_rays_that_miss_have_no_samples_and_color_nothing(device):
    rays = along_x((-1, 1.5, 0.5), (2, 0.5, 0.5), (1, 0.5, 0.5), (-1, 0, 0.5), (-1, 0.5, 0.5))
    found = device_field(even_fog(0.01), device).render_rays(device_rays(rays, device), min_transmittance=0.0)
    s = found.samples
    assert (s.ends - s.starts).tolist() == [0, 0, 0, 8, 8]
    assert not found.out[:3].any() and bool((found.out[3:, 3] > 0.5).all())
    # Eight steps from the middle of the first.
    np.testing.assert_allclose(s.t[:8].cpu(), 1 + (np.arange(8) + 0.5) / 8, rtol=1e-6)
    np.testing.assert_allclose(found.out[4, 3].cpu(), 1 - np.exp(-1.0), rtol=1e-5)
    nothing = device_field(even_fog(0.01), device).render_rays(device_rays(along_x((9, 9, 9)), device))
    assert int(nothing.samples.total) == 0 and not nothing.out.any()


def test_an_opaque_ray_ends_at_the_sample_that_stops_it(device):
    rays = device_rays(along_x((-1, 0.5, 0.5), (0.9, 0.5, 0.5)), device)
    solid = device_field(even_fog(1e3), device).march(rays, 512, 1e-3, None)
    assert (solid.ends - solid.starts).tolist() == [1, 1] and solid.weights.tolist() == [1, 1]
    thin = device_field(even_fog(0.4), device).march(rays, 512, 1e-3, None)  # five a step: under 1e-3 after two
    assert (thin.ends - thin.starts).tolist() == [2, 1]
    limited = device_field(even_fog(0.001), device).march(rays, 3, 1e-3, None)
    assert (limited.ends - limited.starts).tolist() == [3, 1]


def test_corners_and_sides_are_requested_at_zero_and_one(device):
    made = density(8)
    corners = np.array(list(np.ndindex(2, 2, 2)) + [(0.5, 1, 0)], np.float32)
    found = device_field(made, device).density.sigma(torch.from_numpy(corners).to(device))
    expected = torch_reference.vm_density(float64(made.values), made.size.tolist(), made.rank, float64(corners))
    close(found.cpu(), expected, 5e-6)
    along = device_field(made, device).march(device_rays(along_x((-1, 1, 1), jitter=0.0), device), 512, 0.0, None)
    assert along.x[0].tolist() == [0, 1, 1] and bool((along.x[:, 1:] == 1).all())


def test_rays_beyond_the_room_get_no_sample_and_count_for_nothing(device):
    from stylerf.kernels.gpu import launch

    rays = along_x(*[(-1, 0.5, 0.5)] * 4)
    made = device_field(even_fog(0.001), device)
    found = made.render_rays(device_rays(rays, device), capacity=20, min_transmittance=0.0)
    s = found.samples
    assert s.counts.tolist() == [8] * 4 and (s.ends - s.starts).tolist() == [8, 8, 0, 0] and int(s.total) == 16
    sums, wanted = torch.zeros(3, device=device), torch.zeros((4, 4), device=device)
    background = torch.ones((4, 3), device=device)
    gradients = launch.photometric_loss(found.out, wanted, background, s, 0.5, sums)
    assert sums.tolist()[1:] == [16, 2] and not gradients[2:].any() and gradients[0].any()
    # Nothing is read or written beyond what there is: the rest of the room is poisoned.
    for array in (s.x, s.weights, s.sigma, s.deltas, s.t, found.colors):
        array[16:] = float("nan")
    to = [torch.zeros_like(part.values) for part in (made.density, made.color)]
    made.backward(found, gradients, *to)
    assert all(bool(torch.isfinite(t).all()) and t.any() for t in to)


@pytest.mark.parametrize("kind", ["contraction", "frustum"])
def test_closed_spaces_end_in_a_backdrop_that_takes_the_rest(kind, device):
    rays, empty = rays_into(SPACES[kind], 5, 9), OccupancyGrid(8)
    empty.set_occupied(np.zeros(8**3, bool))
    found = device_field(even_fog(1e-5), device, SPACES[kind], occupancy=empty).march(
        device_rays(rays, device), 512, 1e-3, None
    )
    s = on_host(found)
    assert (s.ends - s.starts).tolist() == [1] * 5 and (s.weights == 1).all() and (s.deltas == 0).all()
    assert (s.t == np.float32(SPACES[kind].far)).all()


def test_rays_that_enter_or_leave_a_frustum_have_the_samples_of_the_cpu(device):
    space = SPACES["frustum"]
    origins = [[0.2, 0, 5], [0.2, 0, 5], [0, 0.3, 5], [5, 0, 2], [0, -6, 2], [0, 0, -3], [0, 0, 0.4], [0.5, 0, -3]]
    ways = [[0, 0, -1], [1, 0, 0], [0, -1, 0], [-1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, -1], [0, 0.1, -1]]
    starts, middle = np.float32(origins) * np.float32(space.near), np.full(8, 0.5, np.float32)
    rays, fog = Rays.of(starts, np.float32(ways), space.near, middle), even_fog(1e-5)
    host = RadianceField(space, fog, hash_color(1), occupied(), 1 / 8).march(rays, 512, 1e-3, 1)
    found = device_field(fog, device, space).march(device_rays(rays, device), 512, 1e-3, None)
    counts = (found.ends - found.starts).tolist()
    assert counts == (host.ends - host.starts).tolist() and counts[6:] == [1, 1] and min(counts[:6]) > 5
    np.testing.assert_allclose(found.t[: sum(counts[:6])].cpu(), Packed.of(host).t[: sum(counts[:6])], rtol=1e-5)


def test_rays_that_look_back_in_a_frustum_skip_as_on_the_cpu(device):
    space, occupancy, generator = SPACES["frustum"], OccupancyGrid(32), np.random.default_rng(3)
    wall = np.zeros((32,) * 3, bool)
    wall[..., 4] = True
    occupancy.set_occupied(wall.ravel())
    ways = np.stack([*generator.uniform(-0.1, 0.1, (2, 12)), np.full(12, -1.0)], 1)
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    rays, fog = Rays.of(np.tile(np.float32([0, 0, 4]), (12, 1)), ways.astype(np.float32), space.near), even_fog(1e-5)
    host = RadianceField(space, fog, hash_color(1), occupancy, 1 / 64).march(rays, 512, 1e-3, 1)
    found = device_field(fog, device, space, 1 / 64, occupancy).march(device_rays(rays, device), 512, 1e-3, None)
    counts = host.ends - host.starts, on_host(found).ends - on_host(found).starts
    assert counts[0].min() > 1 and (np.abs(counts[0] - counts[1]) <= 1).all()


@pytest.mark.parametrize("kind", ["contraction", "frustum"])
def test_a_sample_that_was_not_counted_takes_the_backdrops_light(kind, device, monkeypatch):
    """The two launches of a march are compiled separately: rounding can give the second one a sample more."""
    from stylerf.kernels.gpu import launch

    march_rays = launch._march_rays

    def miscounted(inputs, density, rays, samples, last, capacity, fill):
        march_rays(inputs, density, rays, samples, last, capacity, fill)
        if not fill:
            samples.counts -= 1

    rays, field = device_rays(rays_into(SPACES[kind], 5, 9), device), device_field(even_fog(1e-4), device, SPACES[kind])
    whole = field.march(rays, 512, 1e-3, None)
    light = whole.weights[whole.ends - 1]  # of the backdrops
    assert bool((whole.deltas[whole.ends - 1] == 0).all()) and bool((light > 0.1).all())
    monkeypatch.setattr(launch, "_march_rays", miscounted)
    found = field.march(rays, 512, 1e-3, None)
    assert torch.equal(found.ends - found.starts, whole.ends - whole.starts - 1)
    sums = torch.zeros(5, device=device).index_add_(0, found.ray_of.long(), found.weights)
    np.testing.assert_allclose(sums.cpu(), 1, atol=1e-5)
    expected = whole.weights[whole.ends - 2] + light
    np.testing.assert_allclose(found.weights[found.ends - 1].cpu(), expected.cpu(), rtol=1e-5)
    assert bool((found.largest >= found.weights[found.ends - 1]).all())


@pytest.mark.parametrize("kind", SPACES)
def test_leaps_reach_every_occupied_cell_that_the_cpu_reaches(kind, device):
    full, occupancy = np.zeros((8, 8, 8), bool), OccupancyGrid(8)
    full[3:5, 2:4, 3:6] = True
    full[6, 6, 6] = True
    occupancy.set_occupied(full.ravel())
    made, rays = even_fog(1e-4), rays_into(SPACES[kind], 12, 13)
    field = RadianceField(SPACES[kind], made, hash_color(1), occupancy, 1 / 24)
    cpu = field.march(rays, 512, 1e-3, 1)
    gpu = device_field(made, device, SPACES[kind], 1 / 24, occupancy)
    found = on_host(gpu.march(device_rays(rays, device), 512, 1e-3, None))
    counts = cpu.ends - cpu.starts, found.ends - found.starts
    assert counts[0].max() > 2 and (np.abs(counts[0] - counts[1]) <= 1).all()


def test_offsets_beyond_two_to_the_thirty_first(device):
    from tests.stylerf.kernels.gpu.offsets import offsets_kernel

    rows = torch.tensor([0, 715_827_882, 715_827_883, 2**31 - 1], dtype=torch.int32, device=device)
    out = torch.empty(4, dtype=torch.int64, device=device)
    for width, column in ((3, 2), (64, 63)):
        offsets_kernel[(1,)](rows, out, width, column, BLOCK=4)
        assert out.tolist() == [int(row) * width + column for row in rows]
