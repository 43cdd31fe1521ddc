"""march, encode and composite on the device against the float64 oracle: samples, pixels and gradients."""

from functools import cache

import numpy as np
import pytest
import torch

from stylerf.geometry.spherical_harmonics import harmonics
from tests.stylerf.kernels import torch_reference
from tests.stylerf.kernels.gpu.on_gpu import by_oracle, device_rays, gradients_of, on_host
from tests.stylerf.small import (
    SPACES,
    SPARSE,
    Packed,
    close,
    density,
    displacement_grid,
    field_of,
    float64,
    hash_color,
    hash_density,
    headed,
    oracle_color,
    oracle_density,
    points_on,
    rays_into,
    vm_color,
    voxel_density,
)

STEP = 1 / 8
# Space, density, color, displaced: every space, every kind, degrees 0 to 2 and a displacement, at one walk each.
CASES = {
    "box": ("box", density, lambda: vm_color(4, degree=1), False),
    "box displaced": ("box", density, lambda: hash_color(5), True),
    "contraction": ("contraction", density, lambda: vm_color(4, degree=2), False),
    "frustum": ("frustum", density, lambda: vm_color(4, degree=0), False),
    "hash, contraction": ("contraction", hash_density, lambda: headed(4, "hash", "linear"), False),
    "voxel, box displaced": ("box", voxel_density, lambda: headed(4, "voxel", "linear", 2, SPARSE), True),
    "hash, frustum": ("frustum", hash_density, lambda: headed(4, "vm", "mlp"), False),
}


@cache
def walked(case: str, device, rays: int = 14):
    """(field, rays, device field, what it rendered, dL/d(pixels), device gradients): computed once a case."""
    from stylerf.fields.gpu.field import GpuField

    kind, density_of, color, displaced = CASES[case]
    field = field_of(SPACES[kind], 3, color(), STEP, displacement_grid(6) if displaced else None)
    field.density = density_of(3)
    field.density.values[-1] = -4.5  # thin: rays go on long enough to end in the background
    made, going = GpuField(field, device), rays_into(SPACES[kind], rays, 4)
    rendered = made.render_rays(device_rays(going, device), weight_threshold=0.05)
    towards = np.random.default_rng(7).normal(size=(rays, 5)).astype(np.float32)
    return field, going, made, rendered, towards, gradients_of(made, rendered, towards)


@pytest.mark.parametrize("case", CASES)
def test_every_sample_equals_the_oracle_at_its_distance(case, device):
    field, rays, _, rendered, _, _ = walked(case, device)
    space, packed = field.space, Packed.of(on_host(rendered.samples))
    assert len(packed.rays) == int(rendered.samples.total) == rendered.samples.capacity > 20
    assert torch.equal(rendered.samples.ray_of.cpu().long(), packed.rays)
    where, ways = points_on(rays, packed)
    x, end = torch_reference.warp(space, where), packed.background
    assert bool(end.any()) == (space.kind != "box")
    length = (
        STEP
        / torch_reference.speed(space, where, ways)
        * torch_reference.density_jacobian(space, where)
        * torch_reference.OPTICAL_SCALE
    )
    close(packed.deltas[~end], length[~end], 1e-3 if space.kind == "contraction" else 2e-5)
    if field.displacement is not None:
        x = torch.where(end[:, None], x, torch_reference.displaced(float64(field.displacement), x))
    np.testing.assert_allclose(packed.x, x, atol=3e-6)
    sigma = oracle_density(field.density, float64(field.density.values), packed.x)
    close(packed.sigma[~end], sigma[~end], 5e-6)
    weights, _ = torch_reference.weights(packed.sigma, packed.deltas, packed.rays, end)
    np.testing.assert_allclose(packed.weights, weights, atol=3e-6)
    largest = torch.zeros(len(rays.origins), dtype=torch.float64).index_reduce(0, packed.rays, packed.weights, "amax")
    assert torch.equal(rendered.samples.largest.cpu().double(), largest)


@pytest.mark.parametrize("case", CASES)
def test_the_device_walks_as_the_cpu_does(case, device):
    field, rays, _, rendered, _, _ = walked(case, device)
    cpu = field.march(rays, 512, 1e-3, 1)
    found = on_host(rendered.samples)
    # One sample may fall on either side of a ray's end.
    assert (np.abs((cpu.ends - cpu.starts) - (found.ends - found.starts)) <= 1).all()
    for r in range(len(rays.origins)):
        a, b = cpu.t[cpu.starts[r] : cpu.ends[r]], found.t[found.starts[r] : found.ends[r]]
        both = min(len(a), len(b)) - 1
        if field.space.kind == "frustum":  # steps are even in the cube: by the inverse of the distance
            np.testing.assert_allclose(1 / a[:both], 1 / b[:both], atol=1e-6)
        else:
            np.testing.assert_allclose(a[:both], b[:both], rtol=2e-4 if field.space.kind != "box" else 2e-6)


@pytest.mark.parametrize("case", CASES)
def test_colors_equal_the_oracle_above_the_weight_threshold(case, device):
    field, rays, _, rendered, _, _ = walked(case, device)
    packed, color = Packed.of(on_host(rendered.samples)), field.color
    largest = rendered.samples.largest.cpu().double()[packed.rays]
    shown = packed.weights >= np.float32(0.05) * largest
    found = rendered.colors.cpu().double()
    assert bool(shown.any()) and not bool(shown.all())
    assert bool((found[~shown, 0] == -1).all())
    basis = float64(harmonics(rays.directions, color.degree))[packed.rays]
    expected = oracle_color(color, float64(color.values), basis, packed.x)
    np.testing.assert_allclose(found[shown], expected[shown], atol=3e-6)


@pytest.mark.parametrize("case", CASES)
def test_pixels_and_gradients_equal_the_oracle(case, device):
    field, rays, _, rendered, towards, found = walked(case, device)
    grid = None if field.displacement is None else float64(field.displacement)
    pixels, expected = by_oracle(field, rays, rendered, grid, gradients=towards)
    for part, gradients in zip((field.density, field.color), expected):
        gradients[: part.groups()[0][0]] = 0  # what stands for blocks that a voxel grid does not keep never learns
    close(rendered.out.cpu(), pixels, 1e-5)
    close(found[0], expected[0], 1e-4 if field.space.kind == "contraction" else 2e-5, "density")
    close(found[1], expected[1], 2e-5, "color")
    assert all(bool((e != 0).any()) for e in expected)


def test_near_samples_learn_by_the_square_of_their_distance(device):
    field, _, made, rendered, towards, plain = walked("frustum", device)
    found = gradients_of(made, rendered, towards, near_scaling_distance=2.0)
    far = gradients_of(made, rendered, towards, near_scaling_distance=0.5)  # nearer than the near plane: all alike
    close(far[0], plain[0], 1e-6)
    from stylerf.kernels.cpu.compositing import composite_backward, scale_near_gradients

    s, n = on_host(rendered.samples), rendered.samples.capacity
    sigma, color = np.zeros(n, np.float32), np.zeros((n, 3), np.float32)
    colors = rendered.colors.cpu().numpy()
    composite_backward(s, colors, rendered.out.cpu().numpy(), towards, 1, sigma, color)
    scale_near_gradients(s, np.float32(2.0), 1, sigma, color)
    to = np.zeros((1, len(field.density.values)), np.float32)
    field.density.backward(s, sigma, to)
    close(found[0], to[0], 2e-5)
    assert not np.allclose(found[0], plain[0], rtol=1e-2)
