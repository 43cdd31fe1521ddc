"""Ray ends in a region on a GPU, as in extraction.ends_of_view()."""

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from stylerf.editing.extraction import EVERYWHERE, MOSTLY
from stylerf.fields.gpu.field import GpuField
from stylerf.fields.gpu.memory import in_parts
from stylerf.fields.gpu.parts import marked_cells
from stylerf.fields.marching import SAMPLES_PER_RAY
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.cameras import Camera
from stylerf.kernels.gpu import launch
from stylerf.kernels.gpu.ray_samples import GpuSamples
from stylerf.rendering.view_gpu import rays_of

RAYS_AT_ONCE = 1 << 17


class GpuRayEnds:
    """ends_of_view() for one field on `device`, equal up to rounding; caches grids on the device."""

    def __init__(self, field: RadianceField, device: torch.device | str, rays_at_once: int = RAYS_AT_ONCE) -> None:
        self._field, self.rays_at_once = GpuField(field, torch.device(device)), rays_at_once
        self._there: list[tuple[np.ndarray, Tensor]] = []

    def _marked(self, grid: np.ndarray) -> Tensor:
        # By identity: grids are not hashable, and comparing cells would cost as much as a copy.
        for here, there in self._there:
            if here is grid:
                return there
        self._there.append((grid, marked_cells(grid, self._field.device)))
        return self._there[-1][1]

    def __call__(self, camera: Camera, grids: list[np.ndarray]) -> list[np.ndarray]:
        """Return the same as ends_of_view(), for each grid of marked cells [s, s, s]."""
        count = camera.height * camera.width
        marked = [self._marked(grid) for grid in grids]

        def part(begin: int, end: int) -> list[Tensor]:
            rays, found = rays_of(camera, torch.arange(begin, end, device=self._field.device)), []
            samples = self._field.march(rays, SAMPLES_PER_RAY, 1e-3, None)
            foreground = replace(samples, weights=torch.where(samples.deltas > 0, samples.weights, 0.0))
            for grid, own in zip(grids, marked):
                ends = _means_inside(own, grid.shape[0], foreground if grid is EVERYWHERE else samples)
                if self._field.opaque_background and grid is not EVERYWHERE:
                    before = _means_inside(own, grid.shape[0], foreground)
                    ends[:, 2] = torch.where(before[:, 1] > MOSTLY * ends[:, 1], before[:, 2], 0.0)
                found.append(ends)
            return found

        parts = in_parts(count, self.rays_at_once, part)
        return [torch.cat(found).cpu().numpy() for found in zip(*parts)]


def _means_inside(marked: Tensor, cells: int, samples: GpuSamples) -> Tensor:
    """Return launch.ends_inside() with means instead of the sums of w t and w x; 0 where nothing is inside."""
    ends = launch.ends_inside(marked, cells, samples)
    ends[:, 2:] /= ends[:, 1:2].clamp(min=1e-8)
    return ends
