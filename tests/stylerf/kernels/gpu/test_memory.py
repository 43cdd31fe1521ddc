"""Whole views where a device's memory does not suffice for the first part: forged, with the same result."""

import numpy as np
import pytest
import torch

from stylerf.fields.gpu import memory
from tests.stylerf.small import field_of, hash_color
from tests.stylerf.training.scenes import AROUND, dome

FIT = 20  # rays


@pytest.fixture
def scarce(monkeypatch):
    """Switches on: marches of more rays than FIT find no memory. Gives the numbers of rays that were marched."""
    from stylerf.fields.gpu.field import GpuField

    march, tried = GpuField.march, []

    def marched(field, rays, *more):
        tried.append(len(rays.origins))
        if tried[-1] > FIT:
            raise torch.OutOfMemoryError("CUDA out of memory")
        return march(field, rays, *more)

    def switched_on() -> list[int]:
        monkeypatch.setattr(GpuField, "march", marched)
        monkeypatch.setattr(memory, "FEWEST", 4)
        return tried

    return switched_on


def test_pictures_surfaces_and_ends_of_rays_come_out_alike(scarce, device):
    from stylerf.editing.extraction_gpu import GpuRayEnds
    from stylerf.rendering.view_gpu import GpuRenderer
    from stylerf.training.stylize.geometry_gpu import GpuFixedGeometry

    field, camera = field_of(AROUND, 3, hash_color(5), 1 / 6), dome(1, 2, 6)[0]
    field.density.values[-1] = -3.0
    cells = np.zeros((4, 4, 4), bool)
    cells[1:3] = True

    def all_of_them() -> list[np.ndarray]:
        view = GpuRenderer(field, device, "float32").view(camera, regions={"one": cells})
        surface = GpuFixedGeometry(field, [camera], 0.2, 1, 0.0, device=device).surface(0)
        (ends,) = GpuRayEnds(field, device)(camera, [cells])
        return [view.rgb, view.masks["one"], view.ray_distance, surface.offsets, surface.weights, ends]

    plenty = all_of_them()
    tried = scarce()
    found = all_of_them()
    assert tried == 3 * [36, 18, 18]
    for ours, expected in zip(found, plenty):
        np.testing.assert_allclose(ours, expected, rtol=1e-6, atol=1e-7)  # other sizes may round differently
    assert plenty[0].any() and plenty[1].any() and plenty[4].any()
