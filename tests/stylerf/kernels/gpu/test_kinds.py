"""Hash and voxel densities, encoders with heads, on a device: against the float64 oracle and the CPU's smoothness."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from stylerf.geometry.spherical_harmonics import harmonics
from tests.stylerf.fields.test_encoded_color import PAIRS
from tests.stylerf.kernels.gpu.on_gpu import packed_samples
from tests.stylerf.small import (
    SMALL,
    SPARSE,
    close,
    float64,
    hash_density,
    headed,
    oracle_color,
    oracle_density,
    voxel_density,
)

RAYS = 7
DENSITIES = {"hash": hash_density, "voxel": voxel_density}


def points(count: int = 60) -> np.ndarray:
    """Anywhere in the cube (and so in blocks that a sparse grid lacks), the first on its corners and sides."""
    x = np.random.default_rng(0).random((count, 3), dtype=np.float32)
    corners = np.array([*np.ndindex(2, 2, 2), (0.5, 1, 0)], np.float32)[:count]
    x[: len(corners)] = corners
    return x


def packed(device, count: int = 60):
    """Samples at points(), of uneven rays of which the third is empty; some have no weight."""
    generator = np.random.default_rng(1)
    rays = np.sort(generator.choice([0, 1, 3, 4, 5, 6], count)).astype(np.int32)
    rays[-1:] = RAYS - 1
    weights = generator.uniform(0.1, 1, count).astype(np.float32)
    weights[4::9] = 0
    return packed_samples(points(count), rays, weights, device)


def on_device(part, device, half=False):
    from stylerf.fields.gpu.parts import COLOR_KINDS, DENSITY_KINDS

    return (DENSITY_KINDS if part.kind in DENSITIES else COLOR_KINDS)[part.kind](part, device, half)


@pytest.fixture(params=DENSITIES)
def density(request):
    return DENSITIES[request.param](3)


def only_learning_values_get_gradients(part, found, expected, rounding: float) -> None:
    """Gradients equal where the part learns; what never learns (blocks not kept) has none, whatever was asked there."""
    fixed = part.groups()[0][0]
    assert not found[:fixed].any()
    close(found[fixed:], expected[fixed:], rounding)


def color_of(encoder: str, head: str):
    return headed(4, encoder, head, degree=2, capacity=SPARSE if encoder == "voxel" else SMALL)


@pytest.mark.parametrize("count", [60, 1])
def test_a_density_and_its_gradient_equal_the_oracle(density, count, device):
    made, s, x = on_device(density, device), packed(device, count), points(count)
    values = float64(density.values).requires_grad_()
    expected = oracle_density(density, values, float64(x))
    close(made.sigma(torch.from_numpy(x).to(device)).cpu(), expected, 3e-6)
    assert made.sigma(torch.empty((0, 3), device=device)).shape == (0,)
    s.sigma[:count] = expected.detach().float().to(device)
    gradients = np.full(s.capacity, np.nan, np.float32)
    gradients[:count] = np.random.default_rng(2).normal(size=count)
    gradients[3 : count - 1 : 11] = 0
    (expected * float64(gradients[:count])).sum().backward()
    to = torch.zeros_like(made.values)
    for _ in range(2):
        made.backward(s, torch.from_numpy(gradients).to(device), to)
    only_learning_values_get_gradients(density, to.cpu() / 2, values.grad, 1e-5)
    assert values.grad[-1] != 0 and (count == 1 or values.grad[:64].any())


@pytest.mark.parametrize(("shift", "limit"), [(-40.0, np.exp(-15.0)), (40.0, np.exp(12.0))])
def test_the_exponent_is_clamped_as_the_cpus(density, shift, limit, device):
    density.values[-1] = shift
    found = on_device(density, device).sigma(torch.from_numpy(points()).to(device))
    np.testing.assert_allclose(found.cpu(), limit, rtol=1e-6)


@pytest.mark.parametrize(("encoder", "head", "count"), [*((*pair, 60) for pair in PAIRS), ("hash", "mlp", 1)])
def test_a_color_and_its_gradient_equal_the_oracle(encoder, head, count, device):
    color = color_of(encoder, head)
    made, s, x = on_device(color, device), packed(device, count), float64(points(count))
    ways = np.random.default_rng(3).normal(size=(RAYS, 3)).astype(np.float32)
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    seen_from = torch.from_numpy(ways).to(device)
    rays, weights = s.ray_of[:count].cpu().long(), s.weights[:count].cpu()
    found = made.visible_colors(s, seen_from, 0.3)
    shown = (weights > 0) & (weights >= 0.3 * s.largest.cpu()[rays])
    assert bool(shown.any()) and bool(shown.all()) == (count == 1)
    values = float64(color.values).requires_grad_()
    expected = oracle_color(color, values, float64(harmonics(ways, 2))[rays], x)
    np.testing.assert_allclose(found[:count].cpu()[shown], expected[shown].detach(), atol=3e-6)
    assert bool((found[:count, 0].cpu()[~shown] == -1).all())
    gradients = torch.randn((count, 3), generator=torch.Generator().manual_seed(4))
    (expected * gradients.double())[shown].sum().backward()
    to, poisoned = torch.zeros_like(made.values), torch.full((s.capacity, 3), float("nan"), device=device)
    poisoned[:count][shown.to(device)] = gradients[shown].to(device)
    found[count:] = float("nan")
    for _ in range(2):
        made.backward(s, seen_from, found, poisoned, to)
    only_learning_values_get_gradients(color, to.cpu() / 2, values.grad, 2e-5)
    length = color.features.length
    assert values.grad[:length].any() and bool(values.grad[length:].any()) == (color.head.length > 0)


def test_a_sample_without_weight_has_no_color(device):
    made, s = on_device(color_of("voxel", "linear"), device), packed(device)
    found = made.visible_colors(s, torch.ones((RAYS, 3), device=device), 0.0)[:60, 0]
    assert torch.equal(found >= 0, s.weights[:60] > 0) and not bool((found >= 0).all())


SMOOTHED = {
    **DENSITIES,
    "voxel, whole": lambda seed: voxel_density(seed, replace(SPARSE, occupancy=None)),  # its blocks reach beyond it
    "hash-linear": lambda seed: color_of("hash", "linear"),
    "voxel-linear": lambda seed: color_of("voxel", "linear"),
    "vm-mlp": lambda seed: color_of("vm", "mlp"),
}


@pytest.mark.parametrize("kind", SMOOTHED)
def test_smoothing_equals_the_cpus(kind, device):
    part = SMOOTHED[kind](3)
    cpu = np.linspace(-1, 1, len(part.values), dtype=np.float32)
    to = torch.from_numpy(cpu.copy()).to(device)
    strength = 2.0 * len(part.values)
    part.smooth(strength, cpu)
    on_device(part, device).smooth(strength, to)
    np.testing.assert_allclose(to.cpu(), cpu, rtol=1e-5, atol=1e-5)


def test_halves_are_read_as_they_are_rounded(density, device):
    rounded = type(density)(*_shape(density), density.values.astype(np.float16).astype(np.float32))
    x = torch.from_numpy(points()).to(device)
    found = on_device(density, device, half=True)
    assert found.table.dtype == torch.float16
    rounded.values[-1] = density.values[-1]
    close(found.sigma(x).cpu(), on_device(rounded, device).sigma(x).cpu(), 1e-6)


def _shape(part) -> tuple:
    return (part.levels,) if part.kind == "hash" else (part.grid,)


def test_kinds_without_kernels_are_reported_in_one_line():
    from stylerf.fields.gpu.field import unsupported
    from tests.stylerf.small import SPACES, field_of

    field = field_of(SPACES["box"], 1, headed(1, "voxel", "mlp", capacity=SPARSE))
    field.density = hash_density(1)
    assert unsupported(field) is None
    field.color.kind = "palette"
    assert "palette" in unsupported(field)
