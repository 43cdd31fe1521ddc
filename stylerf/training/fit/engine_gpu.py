"""The engine of a fit on a GPU: field, photos, rays, gradients and moments stay on the device.

A step is about fifteen kernel launches without synchronization. Its error and number of samples arrive a few steps
later (async_readback.py).
"""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch
from torch import Tensor

from stylerf.fields.gpu.field import GpuField, GpuRendered, decide, refresh
from stylerf.fields.gpu.parts import GpuPart
from stylerf.fields.radiance_field import RadianceField
from stylerf.kernels.gpu import launch
from stylerf.kernels.gpu.ray_samples import GpuRays
from stylerf.training.common.adam import moments_of, restore_moments
from stylerf.training.common.adam_gpu import GpuAdam
from stylerf.training.common.async_readback import AsyncReadback
from stylerf.training.common.process_group import SINGLE_PROCESS, ProcessGroup
from stylerf.training.common.ray_dataset import RayDataset
from stylerf.training.common.ray_dataset_gpu import GpuRayDataset, unhidden
from stylerf.training.fit.engine import Batch, StepResult, parts_of
from stylerf.training.fit.seen_cells import SeenCells
from stylerf.training.fit.settings import FitSettings

CAPACITY_FACTOR = 4  # sample capacity relative to a batch's target; rays beyond it are left out of the step
MIN_CAPACITY = 1 << 18


def opacity_gradient(rendered: GpuRendered, weight: float, rays: int) -> Tensor:
    """engine.opacity_gradient() for some of `rays` rays; rays that were left out have no gradient."""
    return torch.where(_whole(rendered), (4 * weight / rays) * (1 - 2 * rendered.out[:, 3].clamp(0, 1)), 0.0)


def coverage_gradient(rendered: GpuRendered, wanted: Tensor, weight: float, rays: int) -> Tensor:
    """engine.coverage_gradient(), likewise."""
    return torch.where(_whole(rendered), (2 * weight / rays) * (rendered.out[:, 3] - wanted), 0.0)


def _whole(rendered: GpuRendered) -> Tensor:
    """Return which rays have all of their samples."""
    s = rendered.samples
    return s.counts == s.ends - s.starts


@contextmanager
def out_of_memory() -> Iterator[None]:
    """Raise MemoryError when the GPU is out of memory."""
    try:
        yield
    except torch.OutOfMemoryError as error:
        torch.cuda.empty_cache()
        raise MemoryError(str(error)) from error


def _learned(sums: list[float], rays: int) -> StepResult:
    """Return the result from a step's sums (squared error, samples, rays left out)."""
    error, samples, left_out = sums
    # If rays were left out, there were more samples than counted.
    counted = max(1.0, rays - left_out)
    return StepResult(error / (3 * counted), samples / counted)


class GpuEngine:
    """Engine on `device`. samples: FitSettings.samples; `threads` is unused.

    With several processes, each has its own GPU; gradients are summed on the GPUs.
    """

    most_rays = 1 << 17

    def __init__(
        self,
        dataset: RayDataset,
        seed: int,
        threads: int,
        field: RadianceField,
        group: ProcessGroup = SINGLE_PROCESS,
        *,
        device: torch.device | str,
        samples: int,
        gradient_clip: float = 0.0,
    ) -> None:
        self.device, self.group, self.gradient_clip = torch.device(device), group, gradient_clip
        self.dataset, self.seed = GpuRayDataset(dataset, self.device), seed
        self.capacity = max(MIN_CAPACITY if self.device.type == "cuda" else 0, CAPACITY_FACTOR * samples)
        self._copy(field)
        self.density_adam = GpuAdam.of(self.device_field.density, gradient_clip)
        self.color_adam = GpuAdam.of(self.device_field.color, gradient_clip)
        self._seen: SeenCells | None = None

    def _copy(self, field: RadianceField) -> None:
        """Copy a field to the device; pending readbacks belong to the previous one."""
        self._host, self._stale = field, False
        self._parts = field.density, field.color  # the field may get different parts before it is adopted again
        self.device_field = GpuField(field, self.device)
        self._hull = self.device_field.clear
        self._reports = AsyncReadback(self.device, 3, _learned, StepResult(0.0, 0.0), in_step=True)

    def adopt(self, field: RadianceField) -> None:
        density, color = self._parts
        self._copy(field)
        self.density_adam = self._adam_of(self.device_field.density, self.density_adam, density is field.density)
        self.color_adam = self._adam_of(self.device_field.color, self.color_adam, color is field.color)
        if self._seen is not None and self._seen.cells != field.occupancy.cells:
            self._seen = self._seen.resized(field.occupancy.cells)

    def _adam_of(self, part: GpuPart, before: GpuAdam, kept: bool) -> GpuAdam:
        """Return an optimizer for a part's new tensors; if the part was kept, with the moments of `before`."""
        adam = GpuAdam.of(part, self.gradient_clip)
        if kept:
            adam.first, adam.second, adam.steps = before.first, before.second, before.steps
            adam.running_norm = before.running_norm
        return adam

    @property
    def field(self) -> RadianceField:
        if self._stale:
            self.device_field.write_to(self._host)
            self._stale = False
        return self._host

    @property
    def parameters(self) -> int:
        return self._host.parameters

    def refresh(self, seed: int, stride: int, elapsed: float = 0.0) -> None:
        with out_of_memory():
            if self._seen is not None:
                self._seen.update(elapsed, self.group)
                self._clear_unseen()
            refresh(self.device_field, seed, stride, 0.9)
        self._stale = True

    def _clear_unseen(self) -> None:
        if self._seen is not None:
            unseen = self._seen.unseen()
            self.device_field.clear = unseen if self._hull is None else unseen | self._hull

    def learn(self, batch: Batch) -> StepResult:
        if batch.least_weight > 0 and self._seen is None:
            self._seen = SeenCells(self.device_field.cells, self.device)
        sums = self._reports.begin()
        with out_of_memory():
            self._add_gradients(batch, sums)
        # From here on, running out of memory ends the run: a retried step would request the sums twice.
        for summed in (sums, self.density_adam.gradients, self.color_adam.gradients):
            self.group.add(summed)
        self.density_adam.step(batch.rate)
        self.color_adam.step(batch.rate)
        self._stale = True
        return self._reports.send(batch.rays)

    def _add_gradients(self, batch: Batch, sums: Tensor) -> None:
        """Add the gradients of this process's rays and of the smoothness; add errors and counts to sums [3]."""
        field = self.device_field
        # The kernel's generator is counter-based: a ray's draw depends on the seed and the ray, not on the partition.
        seed = (self.seed * 1_000_003 + batch.step) & 0x7FFFFFFF
        level = None if batch.background == "random" else 0.0 if batch.background in ("black", "none") else 1.0
        own = self.group.own(batch.rays)
        for some in parts_of(own.start, own.stop, batch.parts):
            drawn = self.dataset.draw(
                seed, some.start, some.stop - some.start, batch.rays, batch.among, batch.lit_share, level,
                self.seed & 0x7FFFFFFF, batch.earlier,
            )  # fmt: skip
            rendered = field.render_rays(drawn.rays, capacity=-(-self.capacity // batch.parts))
            if field.opaque_background and self.dataset.channels == 4:
                drawn.wanted = unhidden(drawn.wanted, rendered.out, drawn.background)
            images, scale = (rendered.out, drawn.wanted, drawn.background), 2 / (3 * batch.rays)
            gradients = launch.photometric_loss(*images, rendered.samples, scale, sums)
            if batch.opacity > 0:
                gradients[:, 3] += opacity_gradient(rendered, batch.opacity, batch.rays)
            if batch.coverage > 0:
                gradients[:, 3] += coverage_gradient(rendered, drawn.wanted[:, 3], batch.coverage, batch.rays)
            to = self.density_adam.gradients, self.color_adam.gradients
            field.backward(
                rendered, gradients, *to,
                near_scaling_distance=batch.near_scaling_distance, distortion=batch.distortion / batch.rays,
            )  # fmt: skip
            if self._seen is not None:
                launch.mark_cells(rendered.samples, self._seen.cells, batch.least_weight, self._seen.marked)
        both = (field.density, self.density_adam), (field.color, self.color_adam)
        for strength, (part, adam) in zip(batch.smoothness, both):
            if strength > 0 and self.group.first:
                part.smooth(strength, adam.gradients)

    def discard(self) -> None:
        self.density_adam.gradients.zero_()
        self.color_adam.gradients.zero_()

    def rendered(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        found = np.empty((len(origins), 5), np.float32)
        for at in range(0, len(origins), 1 << 16):
            part = slice(at, at + (1 << 16))
            rays = GpuRays.of(origins[part], directions[part], self.device)
            found[part] = self.device_field.render_rays(rays).with_surface_distance().cpu().numpy()
        return found

    def follow_exposure(self) -> None:
        self.dataset.follow_exposure()

    def settle(self) -> None:
        self._reports.settle()

    def agree(self) -> None:
        for part in (self.device_field.density, self.device_field.color):
            self.group.take_first(part.values)
        if self.group.count > 1:  # GPUs of different types draw different points
            self.group.take_first(self.device_field.highest)
            decide(self.device_field)
            self._stale = True

    def moments(self) -> dict[str, np.ndarray]:
        moments = moments_of({"density": self.density_adam, "color": self.color_adam})
        return moments if self._seen is None else moments | self._seen.arrays()

    def restore_moments(self, arrays: dict[str, np.ndarray]) -> None:
        restore_moments({"density": self.density_adam, "color": self.color_adam}, arrays)
        self._seen = SeenCells.restore(arrays, self.device_field.cells, self.device)
        self._clear_unseen()

    def warm_up(self, scratch: list[RadianceField], settings: FitSettings) -> None:
        # Kernels differ between random and fixed backgrounds (None, 1.0) and by the parts' kinds; data do not matter.
        sums = torch.zeros(3, device=self.device)
        for host in scratch:
            field = GpuField(host, self.device)
            parts: tuple[GpuPart, GpuPart] = field.density, field.color
            adams = GpuAdam.of(parts[0]), GpuAdam.of(parts[1])
            refresh(field, 0, 1, 0.9)
            for level in (None, 1.0):
                drawn = self.dataset.draw(0, 0, 16, 16, self.dataset.views, 0.5, level)
                rendered = field.render_rays(drawn.rays, capacity=16 * 64)
                images = rendered.out, drawn.wanted, drawn.background
                gradients = launch.photometric_loss(*images, rendered.samples, 1.0, sums)
                to = adams[0].gradients, adams[1].gradients
                field.backward(
                    rendered, gradients, *to,
                    near_scaling_distance=settings.near_scaling_distance, distortion=settings.distortion,
                )  # fmt: skip
                if settings.least_weight > 0:
                    launch.mark_cells(rendered.samples, 8, 1.0, torch.zeros(512, dtype=torch.uint8, device=self.device))
            for part, adam, weight in zip(parts, adams, settings.smoothness):
                if weight > 0:
                    part.smooth(weight, adam.gradients)
                adam.step(1e-3)
        self.group.add(torch.zeros(1, device=self.device))  # the first collective connects the GPUs
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)
