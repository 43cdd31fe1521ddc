"""Train a deformation on a GPU; network, grid, gradients, moments and occupancy stay there."""

import math

import numpy as np
import torch
from torch import Tensor

from stylerf.fields.color_map import before_map
from stylerf.fields.deformation import Deformation
from stylerf.fields.gpu.field import FARTHEST as FARTHEST_CELL
from stylerf.fields.gpu.field import GpuField, distances_to
from stylerf.fields.marching import SAMPLES_PER_RAY
from stylerf.fields.occupancy_grid import OccupancyGrid
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.cameras import Camera
from stylerf.kernels.gpu import launch
from stylerf.kernels.gpu.launch import displaced_cells
from stylerf.kernels.gpu.ray_samples import GpuRays
from stylerf.training.common.adam_gpu import GpuAdam
from stylerf.training.common.async_readback import AsyncReadback, sent
from stylerf.training.common.ray_dataset_gpu import unhidden
from stylerf.training.deform.deformer import GridDeformer, rates_of

RAYS_AT_ONCE = 1 << 16
MOST_SAMPLES = 1 << 24  # per step, 1.3 GB; rays that exceed it are left out of the step


class GpuDeformer(GridDeformer[Tensor]):
    """The GPU implementation. device_field: the deforming field on the GPU, through which rays are marched.

    What the cameras see is determined once, by the CPU kernels. `field` and `deformation` are only updated by
    collect(). gradients: flat [3 vertices^3].
    """

    def __init__(
        self,
        field: RadianceField,
        deformation: Deformation,
        cameras: list[Camera],
        vertices: int,
        seed: int,
        threads: int,
        gradient_clip: float = 0.0,
        anchored: bool = False,
        *,
        device: torch.device,
    ) -> None:
        self.device = device
        super().__init__(field, deformation, cameras, vertices, seed, threads, gradient_clip, anchored)
        self.collect()

    def _prepare(self, threads: int) -> None:
        self.device_field = GpuField(self.field, self.device)
        assert self.device_field.displacement is not None
        self._grid = self.device_field.displacement.view(-1, 3)
        self._at_rest = torch.from_numpy(self.rest.distances).to(self.device)
        self.gradients = torch.zeros(3 * self.vertices**3, device=self.device)
        values = torch.from_numpy(self.deformation.values).to(self.device, copy=True)
        self.adam = GpuAdam(values, rates_of(self.deformation, self.anchored), self.gradient_clip)
        self._sizes = self._no_sizes()
        self._brought: Tensor | None = None

    def _no_sizes(self) -> AsyncReadback[None, float]:
        return AsyncReadback(self.device, 1, lambda sums, _: sums[0], 0.0)

    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        super().restore(arrays)
        self._sizes = self._no_sizes()  # pending readbacks belong to the previous state

    def _gathered(self) -> Tensor:
        return self.gradients.view(-1, 3)

    def look(self) -> None:
        cells, field = self.rest.cells, self.device_field
        reach = math.ceil(self.deformation.reach * cells) + 1  # bounds the displacement per axis
        # A cell of the deformed field is occupied if displacement maps it near an occupied cell of the undeformed one.
        occupied = displaced_cells(self._at_rest, cells, reach, self._grid.view(-1), field.vertices)
        field.distances = distances_to(occupied).flatten()

    def _place(self, distances: np.ndarray) -> None:
        # Clamped as in look(): GPU and CPU can resume each other's checkpoints.
        self.device_field.distances = torch.from_numpy(np.minimum(distances, FARTHEST_CELL)).to(self.device)
        self.collect()

    def _number(self, size: Tensor) -> float:
        self._sizes.begin().copy_(size)
        return self._sizes.send(None)

    def collect(self) -> None:
        self.deformation.values[:] = torch.as_tensor(self.adam.values).cpu().numpy()
        self.grid.reshape(-1, 3)[:] = self._grid.cpu().numpy()
        if self._brought is not self.device_field.distances:  # distances of a fine grid take time to compute
            self.field.occupancy = OccupancyGrid(self.rest.cells, self.rest.highest)
            self.field.occupancy.set_occupied(self.device_field.distances.cpu().numpy() == 0)  # distance 0: occupied
            self._brought = self.device_field.distances


class GpuPhotoError:
    """PhotoError for a GpuDeformer; learn() returns the error of a few steps before. `threads` is unused."""

    def __init__(self, deformer: GpuDeformer, background: float, weight_threshold: float, threads: int) -> None:
        self.deformer, self.background, self.weight_threshold = deformer, background, weight_threshold
        self._reports = AsyncReadback(deformer.device, 3, _mean_error, 0.0)

    def of(self, origins: np.ndarray, directions: np.ndarray, colors: np.ndarray) -> float:
        device, field, total = self.deformer.device, self.deformer.device_field, 0.0
        for at in range(0, len(origins), RAYS_AT_ONCE):
            part = slice(at, at + RAYS_AT_ONCE)
            rays = GpuRays.of(origins[part], directions[part], device)
            out = field.render_rays(rays, weight_threshold=self.weight_threshold).out
            wanted = torch.from_numpy(colors[part]).to(device)
            cover = wanted[:, 3:]
            found = out[:, :3] + (1 - out[:, 3:4]) * self.background
            difference = found - wanted[:, :3] * cover - (1 - cover) * self.background
            total += float(difference.square().sum(dtype=torch.float64))
        return total / (3 * len(origins))

    def learn(self, origins: np.ndarray, directions: np.ndarray, colors: np.ndarray, jitter: np.ndarray) -> float:
        device, field, n = self.deformer.device, self.deformer.device_field, len(origins)
        rays = GpuRays(*(sent(array, device) for array in (origins, directions, jitter)))
        capacity, threshold = min(n * SAMPLES_PER_RAY, MOST_SAMPLES), self.weight_threshold
        rendered = field.render_rays(rays, capacity=capacity, weight_threshold=threshold)
        background = torch.full((n, 3), float(self.background), device=device)
        sums, wanted = self._reports.begin(), sent(colors, device)
        if field.opaque_background:
            wanted = unhidden(wanted, rendered.out, background)
        gradients = launch.photometric_loss(rendered.out, wanted, background, rendered.samples, 2 / (3 * n), sums)
        if field.color_map is not None:
            before_map(gradients, *field.color_map)
        field.backward(rendered, gradients, None, None, self.deformer.gradients)
        return self._reports.send(n)


def _mean_error(sums: list[float], rays: int) -> float:
    """Return the mean squared error from a step's sums (squared error, samples, rays left out)."""
    error, _, left_out = sums
    return error / (3 * max(1.0, rays - left_out))
