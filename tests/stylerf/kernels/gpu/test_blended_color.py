"""Blended colors on the device against the CPU."""

from dataclasses import replace

import pytest

from tests.stylerf.blends import RAYS, corner, fields, layer, over
from tests.stylerf.kernels.gpu.on_gpu import device_rays
from tests.stylerf.small import close


def _blends() -> dict:
    made, marked = fields(), corner()
    mixed = over(made["source"], layer(made["source"], 0.3), layer(made["mapped"], 0.7))
    in_region = over(made["source"], layer(made["mapped"], 1.0), layer(made["plain"], 0.6, marked))
    return {
        "mixed": mixed,
        "in a region": in_region,
        "of blends": over(made["source"], layer(mixed, 0.5), layer(in_region, 0.5), layer(made["plain"], 1.0, ~marked)),
        "bent": replace(mixed, displacement=made["bent"].displacement),
    }


@pytest.mark.parametrize("name", ["mixed", "in a region", "of blends", "bent"])
def test_a_blend_on_the_device_is_the_cpus(device, name):
    from stylerf.fields.gpu.field import GpuField
    from stylerf.rendering.rays import render_rays

    field = _blends()[name]
    rays = type(RAYS)(*(array[:16] for array in RAYS))
    found = GpuField(field, device).render_rays(device_rays(rays, device)).out.cpu()
    close(found, render_rays(field, rays, threads=1).out, 2e-5)


def test_a_layer_without_a_kernel_keeps_a_blend_from_a_gpu():
    pytest.importorskip("triton", reason="Triton is not installed")
    from stylerf.fields.gpu.field import unsupported
    from tests.stylerf.fields.test_palette_color import made as palette_color

    made = fields()
    other = replace(made["plain"], color=palette_color())
    assert unsupported(_blends()["of blends"]) is None
    blend = over(made["source"], layer(made["plain"], 0.5), layer(other, 0.5))
    assert "palette has no GPU kernel" in unsupported(blend)
