"""The engine of a fit on the CPU (engine_gpu.py: on a GPU).

The loop in fitter.py decides when to grow, when to roll back and how fast to learn; an engine holds the field, takes
steps, renders, and updates the occupancy grid.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from stylerf.fields.marching import ScratchArena
from stylerf.fields.protocol import Part
from stylerf.fields.radiance_field import RadianceField
from stylerf.kernels.cpu.ray_samples import Rays
from stylerf.kernels.cpu.regions import mark_cells
from stylerf.rendering.rays import backward, render_rays, with_surface_distance
from stylerf.training.common.adam import Adam, moments_of, restore_moments
from stylerf.training.common.process_group import SINGLE_PROCESS, ProcessGroup
from stylerf.training.common.ray_dataset import RayDataset, background_of, over, target, unhidden
from stylerf.training.fit.settings import FitSettings

if TYPE_CHECKING:
    from stylerf.training.fit.seen_cells import SeenCells


@dataclass(frozen=True)
class Batch:
    """One step on `rays` random rays of the first `among` views, in `parts`; `earlier` and the seed determine the rays.

    earlier: number of rays of all previous steps, whose sequence of draws this step continues. `step` seeds everything
    else that is random. lit_share: fraction of the rays near objects. background: white, black, random or none.
    smoothness: weights of the planes' total variation (density, color), 0: none. All others: see FitSettings.
    """

    step: int
    rays: int
    parts: int
    among: int
    lit_share: float
    background: str
    rate: float
    smoothness: tuple[float, float]
    near_scaling_distance: float
    opacity: float = 0.0
    coverage: float = 0.0
    distortion: float = 0.0
    least_weight: float = 0.0
    earlier: int = 0


@dataclass(frozen=True)
class StepResult:
    """Mean squared error and samples per ray of a step; on a GPU, of the newest finished step."""

    error: float
    samples_per_ray: float


def opacity_gradient(alpha: np.ndarray, weight: float, rays: int) -> np.ndarray:
    """Return d/d(alpha) of weight * mean(4 alpha (1 - alpha)) over `rays`, a prior for clear or opaque rays [n].

    Haze that few views see costs most, at alpha = 1/2; empty space and solids cost nothing.
    """
    return (np.float32(4 * weight / rays) * (1 - 2 * np.clip(alpha, 0, 1))).astype(np.float32)


def coverage_gradient(alpha: np.ndarray, wanted: np.ndarray, weight: float, rays: int) -> np.ndarray:
    """Return d/d(alpha) of weight * mean((alpha - wanted)^2) over `rays`, for the coverage of pixels [n].

    On a background of constant color, matter of that color costs nothing. Random backgrounds reveal it, but noisily:
    their mean squared error is that on mid-gray plus a twelfth of the alphas'.
    """
    return (np.float32(2 * weight / rays) * (alpha - wanted)).astype(np.float32)


def parts_of(start: int, stop: int, parts: int) -> list[slice]:
    """Split start..stop into `parts` slices of about equal size, dropping empty ones."""
    edges = [start + (stop - start) * i // parts for i in range(parts + 1)]
    return [slice(first, end) for first, end in pairwise(edges) if first < end]


class CpuEngine:
    """Numba kernels on `threads` threads; bit-identical for the same seed. most_rays: maximum rays per batch.

    Processes that train together (ProcessGroup) each process their part of a batch; results are sums over all.
    """

    most_rays = 16384

    def __init__(
        self,
        dataset: RayDataset,
        seed: int,
        threads: int,
        field: RadianceField,
        group: ProcessGroup = SINGLE_PROCESS,
        gradient_clip: float = 0.0,
    ) -> None:
        self.dataset, self.seed, self.threads, self.group = dataset, seed, threads, group
        self.gradient_clip, self.field = gradient_clip, field
        self.density_adam, self.color_adam = self._new_adam(field.density), self._new_adam(field.color)
        self._memory = ScratchArena()
        self._seen: SeenCells | None = None
        self._hull = field.occupancy.clear

    def adopt(self, field: RadianceField) -> None:
        """Train this field from now on; moments start at zero, except for a part that is the same object as before."""
        self.field = field
        if self.density_adam.values is not field.density.values:
            self.density_adam = self._new_adam(field.density)
        if self.color_adam.values is not field.color.values:
            self.color_adam = self._new_adam(field.color)
        self._hull = field.occupancy.clear
        if self._seen is not None and self._seen.cells != field.occupancy.cells:
            self._seen = self._seen.resized(field.occupancy.cells)

    def _new_adam(self, part: Part) -> Adam:
        return Adam(part.values, part.groups(), self.threads, self.gradient_clip)

    @property
    def parameters(self) -> int:
        """Number of learnable parameters; does not synchronize with a GPU."""
        return self.field.parameters

    def refresh(self, seed: int, stride: int, elapsed: float = 0.0) -> None:
        """Update the occupancy grid at every stride-th cell. elapsed: fraction of the budget since the last update."""
        field = self.field
        if self._seen is not None:
            self._seen.update(elapsed, self.group)
            self._clear_unseen()
        field.occupancy.refresh(lambda x: field.density.sigma(x, self.threads), field.step, seed, stride, 0.9)

    def _clear_unseen(self) -> None:
        """Empty the cells that no training ray has seen for a long time."""
        if self._seen is not None:
            unseen = self._seen.unseen().numpy()
            self.field.occupancy.empty(unseen if self._hull is None else unseen | self._hull)

    def learn(self, batch: Batch) -> StepResult:
        """Take one step. Raises MemoryError if the batch does not fit; then call discard()."""
        # Pixels form one sequence over all steps (decision 0061); everything else random is seeded by the step, so that
        # a resumed run draws the same numbers. Every process draws the whole batch and then takes its own rays, so the
        # drawing order must not depend on `own` (decision 0020).
        pixels, generator = np.random.default_rng([self.seed, 5]), np.random.default_rng([self.seed, 4, batch.step])
        count, near, own = batch.rays, self.field.space.near, self.group.own(batch.rays)
        origins, directions, colors, _ = self.dataset.draw(
            count, pixels, batch.among, batch.lit_share, own, batch.earlier
        )
        jitter = generator.random(count, dtype=np.float32)[own]
        background = background_of(batch.background, count, generator)[own]
        totals = np.zeros(2)  # squared error, samples
        if batch.least_weight > 0 and self._seen is None:
            from stylerf.training.fit.seen_cells import SeenCells  # imports torch: a second, unneeded for objects

            self._seen = SeenCells(self.field.occupancy.cells)
        for some in parts_of(0, len(origins), batch.parts):
            rays = Rays.of(origins[some], directions[some], near, jitter[some])
            totals += self._learn_part(batch, rays, colors[some], background[some])
        both = (self.field.density, self.density_adam), (self.field.color, self.color_adam)
        # A function of the values, not of rays: if every process added it, the sum would count it repeatedly.
        for strength, (part, adam) in zip(batch.smoothness, both):
            if strength > 0 and self.group.first:
                part.smooth(strength, adam.gradients[0])
        self.group.add(totals)
        for adam in (self.density_adam, self.color_adam):
            self.group.add_gradients(adam.gradients)
        self.density_adam.step(batch.rate)
        self.color_adam.step(batch.rate)
        error, samples = totals.tolist()
        return StepResult(error / (3 * count), samples / count)

    def _learn_part(self, batch: Batch, rays: Rays, colors: np.ndarray, back: np.ndarray) -> tuple[float, int]:
        """Add the gradients of some rays of a batch; return the sum of their squared errors and their sample count."""
        count = batch.rays
        rendered = render_rays(self.field, rays, threads=self.threads, arena=self._memory.reset())
        out = rendered.out
        found = over(out[:, :3], out[:, 3:4], back)
        if self.field.opaque_background and self.dataset.channels == 4:
            colors = unhidden(colors, found)
        difference = found - target(colors, back)
        gradients = np.zeros_like(out)
        # C = rgb + (1 - alpha) back, so dL/d(alpha) = -dL/dC . back. `count` is the number of rays in the whole batch,
        # so parts and processes add up to its mean.
        gradients[:, :3] = difference * np.float32(2 / (3 * count))
        gradients[:, 3] = -(gradients[:, :3] * back).sum(1)
        if batch.opacity > 0:
            gradients[:, 3] += opacity_gradient(out[:, 3], batch.opacity, count)
        if batch.coverage > 0:
            gradients[:, 3] += coverage_gradient(out[:, 3], colors[:, 3], batch.coverage, count)
        to = self.density_adam.gradients, self.color_adam.gradients
        distortion = batch.distortion / count
        backward(
            self.field, rendered, gradients, *to,
            near_scaling_distance=batch.near_scaling_distance, distortion=distortion,
        )  # fmt: skip
        if self._seen is not None:
            marked = self._seen.marked.numpy()
            mark_cells(rendered.samples, self._seen.cells, np.float32(batch.least_weight), self.threads, marked)
        return float(np.square(difference).sum()), rendered.samples.total

    def discard(self) -> None:
        """Discard accumulated gradients."""
        self._memory = ScratchArena()  # its memory is needed for smaller batches
        self.density_adam.gradients[:] = 0
        self.color_adam.gradients[:] = 0

    def rendered(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Return premultiplied color, alpha and distance of rays without jitter, [rays, 5] float32."""
        # Each process renders every count-th chunk; the rest stays zero, so that the sum is complete.
        found = np.zeros((len(origins), 5), np.float32)
        for begin in range(4096 * self.group.place, len(origins), 4096 * self.group.count):
            part = slice(begin, begin + 4096)
            rays = Rays.of(origins[part], directions[part], self.field.space.near)
            rendered = render_rays(self.field, rays, threads=self.threads, arena=self._memory.reset())
            found[part] = with_surface_distance(rendered, self.threads)
        self.group.add(found)
        return found

    def follow_exposure(self) -> None:
        """Copy the exposure of the loop's dataset, if the engine has its own copy of the photos."""

    def settle(self) -> None:
        """Wait for pending steps, whose time would otherwise be attributed to what follows."""

    def agree(self) -> None:
        """Copy the first process's values, so that rounding differences do not accumulate."""
        for part in (self.field.density, self.field.color):
            self.group.take_first(part.values)

    def moments(self) -> dict[str, np.ndarray]:
        """Return the optimizers' moments, by name."""
        moments = moments_of({"density": self.density_adam, "color": self.color_adam})
        return moments if self._seen is None else moments | self._seen.arrays()

    def restore_moments(self, arrays: dict[str, np.ndarray]) -> None:
        """Restore moments() for the field adopted last."""
        restore_moments({"density": self.density_adam, "color": self.color_adam}, arrays)
        if "seen.ages" in arrays:
            from stylerf.training.fit.seen_cells import SeenCells

            self._seen = SeenCells.restore(arrays, self.field.occupancy.cells)
        else:
            self._seen = None
        self._clear_unseen()

    def warm_up(self, scratch: list[RadianceField], settings: FitSettings) -> None:
        """Compile all kernels that a step with these settings uses, on these scratch fields."""
        origins, directions, _, _ = self.dataset.draw(16, np.random.default_rng(0))
        rays = Rays.of(origins, directions, self.field.space.near)
        for field in scratch:
            field.occupancy.refresh(lambda x, d=field.density: d.sigma(x, self.threads), field.step, 0, 1, 0.9)
            rendered = render_rays(field, rays, threads=self.threads)
            parts = field.density, field.color
            adams = [Adam(part.values, part.groups(), self.threads) for part in parts]
            to = adams[0].gradients, adams[1].gradients
            backward(
                field, rendered, np.ones_like(rendered.out), *to,
                near_scaling_distance=settings.near_scaling_distance, distortion=settings.distortion,
            )  # fmt: skip
            if settings.least_weight > 0:
                mark_cells(rendered.samples, 8, np.float32(1), self.threads, np.zeros(512, np.uint8))
            for part, adam, weight in zip(parts, adams, settings.smoothness):
                if weight > 0:
                    part.smooth(weight, adam.gradients[0])
                adam.step(1e-3)
