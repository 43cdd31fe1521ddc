"""The fine-tuning engine on a GPU: field, photos, gradients and moments stay there.

A step sends an index and a jitter per ray, about seventy kilobytes, without synchronizing.
"""

import numpy as np
import torch

from stylerf.fields.color_map import before_map
from stylerf.fields.gpu.field import GpuField
from stylerf.fields.gpu.parts import GpuPart, marked_cells
from stylerf.fields.marching import SAMPLES_PER_RAY
from stylerf.fields.radiance_field import RadianceField
from stylerf.fields.region_color import RegionColor
from stylerf.kernels.gpu import launch
from stylerf.training.common.adam import moments_of, restore_moments
from stylerf.training.common.adam_gpu import GpuAdam
from stylerf.training.common.async_readback import AsyncReadback, sent
from stylerf.training.common.process_group import SINGLE_PROCESS, ProcessGroup
from stylerf.training.common.ray_dataset import RayDataset
from stylerf.training.common.ray_dataset_gpu import GpuRayDataset, unhidden
from stylerf.training.finetune.engine import FineTuneBatch, FineTuneSettings, parts_of

# Sample capacity: enough for all samples of a step's rays, up to a gigabyte. Rays beyond that are left out of the step.
MAX_CAPACITY = 1 << 24


class GpuFineTuneEngine:
    """CpuFineTuneEngine on `device`, with equal results up to rounding; `threads` is unused."""

    def __init__(
        self,
        field: RadianceField,
        dataset: RayDataset,
        settings: FineTuneSettings,
        threads: int,
        group: ProcessGroup = SINGLE_PROCESS,
        *,
        device: torch.device | str,
    ) -> None:
        self.device, self.settings, self.group = torch.device(device), settings, group
        self.dataset = GpuRayDataset(dataset, self.device)
        self._host = field
        self._within = None
        if isinstance(field.color, RegionColor):
            self._within = marked_cells(field.color.marked, self.device), field.color.cells
        nothing: dict[str, float] = {}
        # In lockstep: a process that saw a NaN earlier would exit, and the others would wait for its gradients.
        self._reports = AsyncReadback(self.device, 5, self._errors, nothing, in_step=group.count > 1)
        self._take_up()

    def _take_up(self) -> None:
        """Load the host's arrays, with zero moments."""
        self._stale = False
        self.device_field = GpuField(self._host, self.device)
        self.color_adam = GpuAdam.of(self.device_field.color)
        self.density_adam = GpuAdam.of(self.device_field.density)

    @property
    def field(self) -> RadianceField:
        if self._stale:
            # The occupancy grid stays unchanged; see trainer.py.
            for part, adam in ((self._host.color, self.color_adam), (self._host.density, self.density_adam)):
                part.values[:] = adam.values.cpu().numpy()
            self._stale = False
        return self._host

    def learn(self, batch: FineTuneBatch) -> dict[str, float]:
        s, field, sums = self.settings, self.device_field, self._reports.begin()
        moving = s.density_factor > 0
        numbers = self.dataset.number_of(batch.views, batch.pixels)
        chosen, jitter, depth = (
            sent(array, self.device) for array in (numbers, batch.jitter, batch.depth.astype(np.float32))
        )
        rays, wanted = self.dataset.at(chosen, jitter)
        capacity = min(len(chosen) * SAMPLES_PER_RAY, MAX_CAPACITY)
        rendered = field.render_rays(rays, capacity=capacity)
        if field.opaque_background and self.dataset.channels == 4:
            wanted = unhidden(wanted, rendered.out, s.background)
        pulling = 2 * s.depth_weight / batch.inside if moving and batch.inside else 0.0
        scale = 2 / (3 * s.rays)
        gradients = launch.tuning_loss(
            rendered.out, wanted, depth, rendered.samples, s.background, scale, pulling, sums
        )
        if field.color_map is not None:
            before_map(gradients, *field.color_map)
        to = self.density_adam.gradients if moving else None, self.color_adam.gradients
        distance = s.near_scaling_distance
        field.backward(rendered, gradients, *to, near_scaling_distance=distance, density_within=self._within)
        for part, adam, factor, smoothness in self._trained(batch):
            if smoothness > 0 and self.group.first:
                part.smooth(smoothness, adam.gradients)
            self.group.add(adam.gradients)
            adam.step(batch.rate * factor)
        self.group.add(sums)
        self._stale = True
        return self._reports.send(batch.inside)

    def _trained(self, batch: FineTuneBatch) -> list[tuple[GpuPart, GpuAdam, float, float]]:
        """Return each trained part with its optimizer, rate relative to the colors', and weight of total variation."""
        factor, (density, color) = self.settings.density_factor, batch.smoothness
        colors = self.device_field.color, self.color_adam, 1.0, color
        return [colors, (self.device_field.density, self.density_adam, factor, density)] if factor > 0 else [colors]

    def _errors(self, sums: list[float], inside: int) -> dict[str, float]:
        outside, within, depth, lost_outside, lost_inside = sums
        of = np.array([self.settings.rays - inside - lost_outside, inside - lost_inside, inside - lost_inside])
        return parts_of(np.array([outside / 3, within / 3, depth]), of)

    def settle(self) -> dict[str, float]:
        return self._reports.settle()

    def moments(self) -> dict[str, np.ndarray]:
        return moments_of({"density": self.density_adam, "color": self.color_adam})

    def resume(self, moments: dict[str, np.ndarray]) -> None:
        self._take_up()
        restore_moments({"density": self.density_adam, "color": self.color_adam}, moments)
