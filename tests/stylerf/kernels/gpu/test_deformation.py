"""Kernels of a deformation: gradients of positions and of the grid against the float64 oracle; where cells move to."""

from functools import cache

import numpy as np
import pytest
import torch

from stylerf.fields.marching import displacement_arrays, occupancy_arrays
from stylerf.fields.occupancy_grid import OccupancyGrid
from stylerf.geometry.spherical_harmonics import harmonics
from stylerf.kernels.cpu.deformation import displaced_cells
from stylerf.rendering.rays import backward, render_rays
from tests.stylerf.kernels.gpu.on_gpu import by_oracle, device_rays, packed_on_device
from tests.stylerf.small import (
    SPACES,
    close,
    density,
    displacement_grid,
    field_of,
    float64,
    hash_color,
    hash_density,
    oracle_color,
    oracle_density,
    rays_into,
    vm_color,
)

COUNT, ROOM = 70, 80


def directions(count: int) -> np.ndarray:
    ways = np.random.default_rng(8).normal(size=(count, 3))
    return (ways / np.linalg.norm(ways, axis=1, keepdims=True)).astype(np.float32)


def loose(device, x: np.ndarray, sigma: np.ndarray | None = None):
    """Samples at positions x [n, 3], one to a ray, as the device holds them; what is beyond them is NaN."""
    from stylerf.kernels.gpu.ray_samples import GpuSamples

    n = len(x)
    poison = torch.full((ROOM,), float("nan"), device=device)
    places = torch.full((ROOM, 3), float("nan"), device=device)
    places[:n] = torch.from_numpy(x)
    densities = poison.clone()
    if sigma is not None:
        densities[:n] = torch.from_numpy(sigma)
    rays, total = torch.arange(ROOM, dtype=torch.int32, device=device), torch.full((1,), n, device=device)
    return GpuSamples(rays.long(), rays.long() + 1, rays, poison, total, poison, poison, places, densities, poison,
                         rays)  # fmt: skip


def positions() -> np.ndarray:
    """Inside of cells, where the slope has one answer; and the cube's corners, whose slope is their only cell's."""
    x = np.random.default_rng(4).uniform(0.01, 0.99, (COUNT, 3)).astype(np.float32)
    x[:8] = list(np.ndindex(2, 2, 2))
    return x


def padded(array: np.ndarray, device) -> torch.Tensor:
    """With NaN in the room beyond."""
    more = np.full((ROOM - len(array), *array.shape[1:]), np.nan, np.float32)
    return torch.from_numpy(np.concatenate([array, more])).to(device)


@pytest.mark.parametrize("kind", ["vm", "hash"])
def test_the_densitys_slopes_equal_the_oracles(kind, device):
    from stylerf.fields.gpu.parts import DENSITY_KINDS

    made, x = density(3) if kind == "vm" else hash_density(3), positions()
    exact = float64(x).requires_grad_()
    sigma = oracle_density(made, float64(made.values), exact)
    gradients = np.random.default_rng(2).normal(size=COUNT).astype(np.float32)
    gradients[[3, 9]] = 0
    (sigma * float64(gradients)).sum().backward()
    samples = loose(device, x, sigma.detach().float().numpy())
    out = torch.full((ROOM, 3), 0.25, device=device)
    DENSITY_KINDS[kind](made, device).add_position_gradients(samples, padded(gradients, device), out)
    close(out[:COUNT].cpu() - 0.25, exact.grad, 2e-5)
    assert bool((out[COUNT:] == 0.25).all()) and bool((out[[3, 9]] == 0.25).all())


COLORS = {"hash": lambda: hash_color(5)} | {f"vm {d}": lambda d=d: vm_color(4, degree=d) for d in (0, 1, 2)}


@pytest.mark.parametrize("kind", COLORS)
def test_colors_slopes_equal_the_oracles(kind, device):
    from stylerf.fields.gpu.parts import COLOR_KINDS

    made, x, ways = COLORS[kind](), positions(), directions(ROOM)
    exact = float64(x).requires_grad_()
    basis = float64(harmonics(ways[:COUNT], getattr(made, "degree", 0)))
    colors = oracle_color(made, float64(made.values), basis, exact)
    gradients = np.random.default_rng(6).normal(size=(COUNT, 3)).astype(np.float32)
    hidden = [4, 11, 30]
    kept = np.setdiff1d(np.arange(COUNT), hidden)
    (colors * float64(gradients))[kept].sum().backward()
    found = colors.detach().float().numpy()
    found[hidden, 0] = -1
    out = torch.full((ROOM, 3), 0.25, device=device)
    COLOR_KINDS[made.kind](made, device).add_position_gradients(
        loose(device, x), torch.from_numpy(ways).to(device), padded(found, device), padded(gradients, device), out
    )
    close(out[:COUNT].cpu() - 0.25, exact.grad, 2e-5)
    assert bool((out[COUNT:] == 0.25).all()) and bool((out[hidden] == 0.25).all())


# Space, color of a field whose whole backward is looked at.
CASES = {
    "box": lambda: vm_color(4, degree=1),
    "contraction": lambda: vm_color(4, degree=2),
    "frustum": lambda: hash_color(5),
}


@cache
def learned(kind: str, device, rays: int = 14):
    """(field, rays, what the CPU rendered, the same on the device, dL/d(pixels), the device's dL/dD).

    Walked by the CPU, which takes a tenth of the interpreter's time.
    """
    from stylerf.fields.gpu.field import GpuField

    field = field_of(SPACES[kind], 3, CASES[kind](), 1 / 8, displacement_grid(6, reach=0.15))
    field.density.values[-1] = -4.5  # thin: rays go on long enough to end in the background
    going = rays_into(SPACES[kind], rays, 4)
    cpu = render_rays(field, going, threads=1, weight_threshold=0.05)
    rendered = packed_on_device(cpu, going, device)
    towards = np.random.default_rng(7).normal(size=(rays, 5)).astype(np.float32)
    return field, going, cpu, rendered, towards, grid_gradient(GpuField(field, device), rendered, towards)


def grid_gradient(made, rendered, towards: np.ndarray) -> torch.Tensor:
    to = torch.zeros(3 * made.vertices**3, device=made.device)
    made.backward(rendered, torch.from_numpy(towards).to(made.device), None, None, to)
    return to.cpu()


@pytest.mark.parametrize("kind", CASES)
def test_the_grids_gradient_equals_the_oracles_and_the_cpus(kind, device):
    field, rays, cpu, rendered, towards, found = learned(kind, device)
    sides = (rendered.samples.x == 0) | (rendered.samples.x == 1)
    assert bool(sides.any()) and not bool(sides.any(1).all())
    assert bool((rendered.samples.deltas == 0).any()) == (kind != "box")  # the background, which does not move
    grid = float64(field.displacement).requires_grad_()
    by_oracle(field, rays, rendered, grid, gradients=towards)
    assert grid.grad.abs().max() > 0
    close(found, grid.grad.flatten(), 1e-4 if kind == "contraction" else 3e-5)
    to = np.zeros((1, field.displacement.size), np.float32)
    backward(field, cpu, towards, None, None, to)
    close(found, to[0], 2e-5)


def test_a_grid_of_zeros_learns_as_one_that_bends(device):
    """Nothing is displaced yet: the samples are those of the field at rest, the gradient is there."""
    from stylerf.fields.gpu.field import GpuField

    field, rays = field_of(SPACES["box"], 3, hash_color(5), 1 / 8), rays_into(SPACES["box"], 6, 4)
    rendered = packed_on_device(render_rays(field, rays, threads=1), rays, device)
    field.displacement = np.zeros((3, 3, 3, 3), np.float32)
    towards = np.random.default_rng(7).normal(size=(6, 5)).astype(np.float32)
    exact = float64(field.displacement).requires_grad_()
    by_oracle(field, rays, rendered, exact, gradients=towards)
    assert exact.grad.abs().max() > 0
    close(grid_gradient(GpuField(field, device), rendered, towards), exact.grad.flatten(), 3e-5)


def spread(device, x, gradient, where=(0.5, 0.5, 0.5), deltas: float = 1.0) -> np.ndarray:
    """dL/dD [2, 2, 2, 3] of one sample of a unit box at `where`, displaced to x."""
    from stylerf.geometry.space_warp import SpaceWarp
    from stylerf.kernels.gpu import launch
    from stylerf.kernels.gpu.ray_samples import GpuRays

    samples = loose(device, np.float32([x]))
    samples.t, samples.deltas = (torch.full((ROOM,), v, device=device) for v in (2.0, deltas))
    ways = torch.tensor([[1.0, 0, 0]], device=device)
    rays = GpuRays(torch.tensor([where], device=device) - 2 * ways, ways, torch.zeros(1, device=device))
    to, space = torch.zeros(24, device=device), SpaceWarp.box([0] * 3, [1] * 3)
    parameters, given = torch.from_numpy(space.packed()).to(device), padded(np.float32([gradient]), device)
    launch.displacement_backward(space.code, parameters, rays, samples, given, 2, to)
    return to.cpu().numpy().reshape(2, 2, 2, 3)


def test_a_sample_spreads_its_gradient_over_its_cells_vertices(device):
    whole = np.broadcast_to(np.float32([1, -2, 3]), (2, 2, 2, 3))
    np.testing.assert_allclose(spread(device, (0.6, 0.4, 0.5), (8, -16, 24)), whole, rtol=1e-5)
    for axis, side in ((0, 0.0), (1, 1.0), (2, 1.0)):
        x = [0.6, 0.4, 0.5]
        x[axis] = side
        np.testing.assert_allclose(spread(device, x, (8, -16, 24)), whole * (np.arange(3) != axis), rtol=1e-5)
    # A sample on the cube's side speaks to that side's vertices alone; one of delta 0 to none.
    found = spread(device, (0.9, 0.4, 0.5), (8, -16, 24), where=(1.0, 0.5, 0.5))
    assert not found[0].any()
    np.testing.assert_allclose(found[1], 2 * whole[1], rtol=1e-5)
    assert not spread(device, (0.6, 0.4, 0.5), (8, -16, 24), deltas=0.0).any()


def test_rays_without_samples_teach_the_grid_nothing(device):
    from stylerf.fields.gpu.field import GpuField

    field = field_of(SPACES["box"], 3, hash_color(5), 1 / 8, displacement_grid(6))
    rays, made = rays_into(SPACES["box"], 5, 4), GpuField(field, device)
    rays.directions[:] *= -1
    for capacity in (None, 40):
        rendered = made.render_rays(device_rays(rays, device), capacity=capacity)
        to = torch.full((375,), 0.5, device=device)
        made.backward(rendered, torch.ones((5, 5), device=device), None, None, to)
        assert int(rendered.samples.total) == 0 and bool((to == 0.5).all())


@pytest.mark.parametrize("reach", [0.05, 0.3])
def test_cells_are_occupied_where_the_cpu_finds_them(reach, device):
    from stylerf.kernels.gpu import launch

    cells, moved, occupancy = 7, displacement_grid(2, cells=4, reach=reach), OccupancyGrid(7)
    occupancy.set_occupied(np.random.default_rng(3).random(cells**3) < 0.03)
    expected = np.zeros(cells**3, np.bool_)
    displaced_cells(occupancy_arrays(occupancy), displacement_arrays(moved), cells, expected)
    distances, grid = (torch.from_numpy(a).to(device) for a in (occupancy.distances, moved.reshape(-1)))
    found = launch.displaced_cells(distances, cells, cells, grid, 4)
    assert np.array_equal(found.cpu().numpy().ravel(), expected) and 0 < expected.sum() < cells**3
    # Only cells within reach are looked at; where nothing is occupied nothing comes to be.
    near = launch.displaced_cells(distances, cells, 1, grid, 4).cpu().numpy().ravel()
    assert np.array_equal(near, expected & (occupancy.distances <= 1))
    nowhere = torch.full_like(distances, 255)
    assert not launch.displaced_cells(nowhere, cells, cells, grid, 4).any()
