"""The fine-tuning engine on the CPU (engine_gpu.py: on a GPU).

The loop in trainer.py selects pixels and learning rate; an engine takes the step. Both engines get the same pixels.
"""

from dataclasses import dataclass

import numpy as np

from stylerf.fields.color_map import before_map
from stylerf.fields.marching import ScratchArena
from stylerf.fields.protocol import Part
from stylerf.fields.radiance_field import RadianceField
from stylerf.fields.region_color import RegionColor
from stylerf.kernels.cpu.ray_samples import Rays
from stylerf.rendering.rays import backward, render_rays
from stylerf.training.common.adam import Adam, moments_of, restore_moments
from stylerf.training.common.process_group import SINGLE_PROCESS, ProcessGroup
from stylerf.training.common.ray_dataset import RayDataset, over, target, unhidden


@dataclass(frozen=True)
class FineTuneSettings:
    """Settings of fine-tuning.

    Attributes:
        seconds, steps: Budget: time, or steps if positive.
        rays: Rays per step.
        inside, beside: Fractions of them through edited pixels, and through pixels around those.
        rate: Learning rate of the colors; decays by the factor `final_rate`.
        density_factor: Learning rate of the density relative to that of the colors; 0 keeps the shapes.
        depth_weight: Weight of the squared relative change of sum(w t) at edited pixels.
        background: Gray level behind the field.
        smoothness, near_scaling_distance: As in FitSettings.
    """

    seconds: float = 60.0
    steps: int = 0
    rays: int = 6144
    inside: float = 0.4
    beside: float = 0.3
    rate: float = 5e-3
    density_factor: float = 0.3
    final_rate: float = 0.05
    depth_weight: float = 1e-3
    background: float = 1.0
    smoothness: tuple[float, float] = (0.0, 0.0)
    near_scaling_distance: float = 0.0


@dataclass(frozen=True, eq=False)
class FineTuneBatch:
    """This process's pixels of one step, edited ones first.

    Attributes:
        views, pixels, jitter: [n]; pixels are row-major.
        depth: [m], target depths of the first m pixels, the edited ones; 0: unconstrained.
        inside: Number of edited pixels over all processes.
        smoothness: Weights of the total variation (density, color); 0: none in this step.
    """

    views: np.ndarray
    pixels: np.ndarray
    jitter: np.ndarray
    depth: np.ndarray
    inside: int
    rate: float
    smoothness: tuple[float, float]


def parts_of(sums: np.ndarray, of: np.ndarray) -> dict[str, float]:
    """Return means by name, from sums over rays outside the edit, inside it, and over depths inside it."""
    return dict(zip(("outside", "inside", "depth"), (sums / np.maximum(of, 1)).tolist(), strict=True))


class CpuFineTuneEngine:
    """Numba kernels on `threads` threads; bit-identical for the same seed."""

    def __init__(
        self,
        field: RadianceField,
        dataset: RayDataset,
        settings: FineTuneSettings,
        threads: int,
        group: ProcessGroup = SINGLE_PROCESS,
    ) -> None:
        self.field, self.dataset, self.settings, self.threads, self.group = field, dataset, settings, threads, group
        self.color_adam = Adam(field.color.values, field.color.groups(), threads)
        self.density_adam = Adam(field.density.values, field.density.groups(), threads)
        self._last: dict[str, float] = {}
        self._memory = ScratchArena()

    def learn(self, batch: FineTuneBatch) -> dict[str, float]:
        """Take one step; return the mean squared errors of colors outside and inside the edit, and of depths.

        A GPU returns those of the newest finished step, none before the first.
        """
        s, field, edited = self.settings, self.field, len(batch.depth)
        moving = s.density_factor > 0
        origins, directions, colors = self.dataset.at(batch.views, batch.pixels)
        rays = Rays.of(origins, directions, field.space.near, batch.jitter)
        rendered = render_rays(field, rays, threads=self.threads, arena=self._memory.reset())
        out, level = rendered.out, np.float32(s.background)
        found = over(out[:, :3], out[:, 3:4], level)
        if field.opaque_background and self.dataset.channels == 4:
            colors = unhidden(colors, found)
        difference = found - target(colors, level)
        gradients = np.zeros_like(out)
        # C = rgb + (1 - alpha) level, so dL/d(alpha) = -level sum(dL/dC). s.rays counts all processes.
        gradients[:, :3] = difference * np.float32(2 / (3 * s.rays))
        gradients[:, 3] = -level * gradients[:, :3].sum(1)
        if field.color_map is not None:
            before_map(gradients, *field.color_map.arrays())
        depth_error = 0.0
        if edited and moving and s.depth_weight > 0:
            known = np.maximum(batch.depth, np.float32(1e-6))
            # d/dz of weight mean((z / z0 - 1)^2) = 2 weight (z / z0 - 1) / (z0 n); relative errors are unitless.
            off = np.where(batch.depth > 0, out[:edited, 4] / known - 1, np.float32(0))
            gradients[:edited, 4] = (2 * s.depth_weight / batch.inside) * off / known
            depth_error = float(np.square(off).sum())
        density_to = self.density_adam.gradients if moving else None
        within = field.color.marked if isinstance(field.color, RegionColor) else None
        to = density_to, self.color_adam.gradients
        backward(field, rendered, gradients, *to, near_scaling_distance=s.near_scaling_distance, density_within=within)
        for part, adam, factor, smoothness in self._trained(batch):
            # A function of the values, not of rays, so only one process adds it.
            if smoothness > 0 and self.group.first:
                part.smooth(smoothness, adam.gradients[0])
            self.group.add_gradients(adam.gradients)
            adam.step(batch.rate * factor)
        squares = np.square(difference).mean(1)
        sums = np.array([squares[edited:].sum(), squares[:edited].sum(), depth_error], np.float64)
        self.group.add(sums)
        self._last = parts_of(sums, np.array([s.rays - batch.inside, batch.inside, batch.inside]))
        return self._last

    def _trained(self, batch: FineTuneBatch) -> list[tuple[Part, Adam, float, float]]:
        """Return each trained part with its optimizer, rate relative to the colors', and weight of total variation."""
        factor, (density, color) = self.settings.density_factor, batch.smoothness
        colors = self.field.color, self.color_adam, 1.0, color
        return [colors, (self.field.density, self.density_adam, factor, density)] if factor > 0 else [colors]

    def settle(self) -> dict[str, float]:
        """Wait for the last step; return its errors."""
        return self._last

    def moments(self) -> dict[str, np.ndarray]:
        """Return the optimizers' moments, by name; the next step may overwrite them."""
        return moments_of({"density": self.density_adam, "color": self.color_adam})

    def resume(self, moments: dict[str, np.ndarray]) -> None:
        """Resume from the field's current arrays and moments()."""
        restore_moments({"density": self.density_adam, "color": self.color_adam}, moments)
