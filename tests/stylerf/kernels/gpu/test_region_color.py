"""A region's own colors on the device: values and gradients against the oracle and the CPU, for any share of cells."""

from functools import cache

import numpy as np
import pytest
import torch

from stylerf.fields.region_color import RegionColor
from stylerf.geometry.spherical_harmonics import harmonics
from stylerf.rendering.rays import backward, render_rays
from tests.stylerf.fields.test_region_color import CELLS, inside, marked_cells, oracle
from tests.stylerf.fields.test_region_color import patch as one_patch
from tests.stylerf.kernels.gpu.on_gpu import device_rays, gradients_of, on_host
from tests.stylerf.small import SPACES, close, field_of, float64, hash_color, headed, rays_into

SHARE = 0.02


def everywhere(made: RegionColor) -> RegionColor:
    return _over(made, np.ones((CELLS,) * 3, bool))


def nowhere_met(made: RegionColor) -> RegionColor:
    """One cell of many, in a corner that no ray meets."""
    marked = np.zeros((64,) * 3, bool)
    marked[0, 0, 0] = True
    return _over(made, marked)


def _over(made: RegionColor, marked: np.ndarray) -> RegionColor:
    other = RegionColor.create(made.base, marked, 30.0, table=64, levels=8)
    other.values[:] = np.random.default_rng(5).normal(scale=0.4, size=len(other.values))
    return other


def on_a_patch(made: RegionColor) -> RegionColor:
    marked = np.zeros((4,) * 3, bool)
    marked[1:3, :, 1:3] = True
    other = RegionColor.create(made, marked, 20.0, table=64)
    other.values[:] = 0.3 * np.random.default_rng(6).normal(size=len(other.values))
    return other


def on_a_network(made: RegionColor) -> RegionColor:
    return RegionColor(headed(2, "vm", "mlp"), made.own, made.marked)


CASES = {
    "some cells": lambda made: made,
    "all": everywhere,
    "none met": nowhere_met,
    "two": on_a_patch,
    "network": on_a_network,
}


@cache
def walked(case: str, device, rays: int = 12):
    """(field, rays, device field, what it rendered, dL/d(pixels)): walked once a case."""
    from stylerf.fields.gpu.field import GpuField

    field = field_of(SPACES["box"], 3, CASES[case](one_patch()), 1 / 8)
    field.density.values[-1] = -4.5  # thin: rays go through the region and beyond
    going = rays_into(SPACES["box"], rays, 4)
    going.origins[-1] += 50  # meets nothing
    made = GpuField(field, device)
    rendered = made.render_rays(device_rays(going, device), weight_threshold=SHARE)
    return field, going, made, rendered, np.random.default_rng(7).normal(size=(rays, 5)).astype(np.float32)


def test_colors_and_gradients_equal_the_oracle(device):
    field, rays, made, rendered, _ = walked("some cells", device)
    s, colors = on_host(rendered.samples), rendered.colors.cpu()
    shown = colors[:, 0] >= 0
    within = inside(s.x) & shown.numpy()
    assert 5 < within.sum() < shown.sum() - 5 and not bool(shown.all())
    values = float64(field.color.values).requires_grad_()
    basis = float64(harmonics(rays.directions, 1))[rendered.samples.ray_of.cpu().long()]
    expected = oracle(field.color, values, basis, float64(s.x))
    close(colors[shown], expected[shown], 5e-6)
    gradients = np.random.default_rng(3).normal(size=s.x.shape).astype(np.float32)
    (expected * float64(gradients))[shown].sum().backward()
    to = torch.zeros_like(made.color.values)
    made.color.backward(rendered.samples, None, rendered.colors, torch.from_numpy(gradients).to(device), to)
    close(to.cpu(), values.grad, 1e-5)


def test_outside_the_cells_the_base_stays_to_the_bit(device):
    _, _, made, rendered, _ = walked("some cells", device)
    base = made.color.base.visible_colors(rendered.samples, rendered.rays.directions, SHARE).cpu()
    found, shown = rendered.colors.cpu(), base[:, 0] >= 0
    within = torch.from_numpy(inside(on_host(rendered.samples).x))
    assert torch.equal(found[shown & ~within], base[shown & ~within])
    assert bool((found[shown & within] != base[shown & within]).any(1).all())
    assert bool((found[~shown, 0] == -1).all())


@pytest.mark.parametrize(
    "case", ["some cells", "all", "none met", "network", pytest.param("two", marks=pytest.mark.slow)]
)
def test_pixels_and_gradients_are_the_cpus(case, device):
    field, rays, made, rendered, towards = walked(case, device)
    cpu = render_rays(field, rays, threads=1, weight_threshold=SHARE)
    close(rendered.out.cpu(), cpu.out, 2e-5)
    to = [np.zeros((1, len(part.values)), np.float32) for part in (field.density, field.color)]
    backward(field, cpu, towards, *to)
    found = gradients_of(made, rendered, towards)
    for ours, expected in zip(found, to):
        close(ours, expected[0], 5e-5)
    assert bool(found[1].any()) == (case != "none met")
    assert not rendered.out[-1].any()


def test_density_learns_in_the_cells_alone(device):
    from stylerf.fields.gpu.parts import marked_cells as on_device

    field, rays, made, rendered, towards = walked("some cells", device)
    cpu = render_rays(field, rays, threads=1, weight_threshold=SHARE)
    for marked in (marked_cells(), np.zeros((CELLS,) * 3, bool)):
        to = np.zeros((1, len(field.density.values)), np.float32)
        backward(field, cpu, towards, to, None, density_within=marked)
        found = torch.zeros_like(made.density.values)
        within = on_device(marked, device), CELLS
        made.backward(rendered, torch.from_numpy(towards).to(device), found, None, density_within=within)
        close(found.cpu(), to[0], 5e-5)
        assert bool(found.any()) == bool(marked.any())


def test_what_a_patch_stands_on_decides_whether_a_gpu_can_have_it():
    from stylerf.fields.gpu.field import unsupported
    from tests.stylerf.fields.test_palette_color import made as palette_color

    assert unsupported(field_of(SPACES["box"], 3, on_a_patch(one_patch()))) is None
    other = RegionColor(palette_color(), hash_color(1), marked_cells())
    assert "palette has no GPU kernel" in unsupported(field_of(SPACES["box"], 3, other))


@pytest.mark.slow
def test_an_edited_view_in_halves_is_the_cpus_picture(device):
    from stylerf.rendering.view import render_view
    from stylerf.rendering.view_gpu import GpuRenderer
    from tests.stylerf.training.scenes import AROUND, dome

    over_hash = RegionColor(hash_color(3), one_patch().own, marked_cells())
    field, camera = field_of(AROUND, 3, over_hash, 1 / 5), dome(1, 2, 4)[0]
    field.density.values[-1] = -4.0
    made = GpuRenderer(field, device, "float16")
    assert made.field.color.table.dtype == made.field.color.base.table.dtype == torch.float16
    np.testing.assert_allclose(made.view(camera).rgb, render_view(field, camera, threads=1).rgb, atol=1e-3)
