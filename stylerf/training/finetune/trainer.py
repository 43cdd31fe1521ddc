"""Fine-tune a field on edited photos (LAENeRF, section 3.5): the colors, and the density if necessary.

LAENeRF adds a depth term whose gradient is discarded by its compositing; ours has an effect. The occupancy grid is
kept: when refreshed, it lost thin cells all over the scene (fox: background error 1.14 times that before the edit,
otherwise 1.05).
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from stylerf.errors import Diverged
from stylerf.fields.radiance_field import RadianceField
from stylerf.fields.region_color import RegionColor
from stylerf.training.common.adam import SMOOTH_EVERY
from stylerf.training.common.even_draws import drawn_evenly
from stylerf.training.common.process_group import SINGLE_PROCESS, ProcessGroup
from stylerf.training.common.ray_dataset import RayDataset
from stylerf.training.finetune.engine import CpuFineTuneEngine, FineTuneBatch, FineTuneSettings

if TYPE_CHECKING:
    from stylerf.training.finetune.engine_gpu import GpuFineTuneEngine

FineTuneEngine: TypeAlias = "CpuFineTuneEngine | GpuFineTuneEngine"


@dataclass
class FineTuneState:
    """Progress of fine-tuning."""

    step: int = 0
    seconds: float = 0.0
    curve: list[dict] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class EditedPixels:
    """Pixels of the edit.

    Attributes:
        views, pixels: [n], view index and row-major pixel.
        depth: [n], sum(w t) of their rays before the edit, scene units; 0 for rays that end in the background.
        beside: (views, pixels) around them, which must keep their colors.
    """

    views: np.ndarray
    pixels: np.ndarray
    depth: np.ndarray
    beside: tuple[np.ndarray, np.ndarray]


class FineTuner:
    """Trains the field in place.

    Args:
        dataset: All training views, edited.
        group: Processes that train together; settings.rays is the total over them.
        engine: Where to train (training/backends.py). Engines see the same rays and resume each other's checkpoints.
    """

    def __init__(
        self,
        field: RadianceField,
        dataset: RayDataset,
        edited: EditedPixels,
        settings: FineTuneSettings,
        seed: int,
        threads: int,
        group: ProcessGroup = SINGLE_PROCESS,
        engine: Callable[..., FineTuneEngine] = CpuFineTuneEngine,
    ) -> None:
        self.group, self.dataset, self.edited, self.settings, self.seed = group, dataset, edited, settings, seed
        self.state = FineTuneState()
        # Whether all trained values are near the edit, so that rays far from it are useless.
        self.local = isinstance(field.color, RegionColor) and settings.density_factor == 0
        self.engine = engine(field, dataset, settings, threads, group)
        self.between_steps = True

    @property
    def field(self) -> RadianceField:
        """The current field."""
        return self.engine.field

    @property
    def progress(self) -> float:
        """Spent fraction of the budget, 0..1."""
        s = self.settings
        return min(1.0, self.state.step / s.steps if s.steps else self.state.seconds / s.seconds)

    def _batch(self) -> FineTuneBatch:
        """Return this process's pixels of the step.

        A step has edited pixels first, then pixels around them, then arbitrary ones; a process takes its slice.
        """
        # Seeded by the step, for resuming. Every process draws all numbers and keeps its part, so that together they
        # take the same rays as a single process.
        s, generator = self.settings, np.random.default_rng([self.seed, 9, self.state.step])
        inside = min(round(s.rays * s.inside), s.rays) if len(self.edited.pixels) else 0
        chosen = drawn_evenly(inside, max(1, len(self.edited.pixels)), generator)
        views, pixels = self.edited.beside
        beside = s.rays - inside if self.local else min(round(s.rays * s.beside), s.rays - inside)
        beside = beside if len(pixels) else 0
        around = drawn_evenly(beside, max(1, len(pixels)), generator)
        own, others = self.group.own(s.rays), s.rays - inside - beside
        chosen, around = chosen[_overlap(own, 0, inside)], around[_overlap(own, inside, beside)]
        drawn = (
            (self.edited.views[chosen], self.edited.pixels[chosen]),
            (views[around], pixels[around]),
            self.dataset.choose(others, generator, part=_overlap(own, s.rays - others, others)),
        )
        own_views, own_pixels = (np.concatenate(of_each) for of_each in zip(*drawn))
        smoothing = SMOOTH_EVERY if self.state.step % SMOOTH_EVERY == 0 else 0
        return FineTuneBatch(
            own_views,
            own_pixels,
            jitter=generator.random(s.rays, dtype=np.float32)[own],
            depth=self.edited.depth[chosen],
            inside=inside,
            rate=s.rate * s.final_rate**self.progress,
            smoothness=(smoothing * s.smoothness[0], smoothing * s.smoothness[1]),
        )

    def step(self) -> dict[str, float]:
        """Take one step; return the mean squared errors of colors outside and inside the edit, and of depths."""
        return self.engine.learn(self._batch())

    def run(self, on_step: Callable[["FineTuner"], None] = lambda tuner: None) -> None:
        """Train until the budget is spent, calling on_step after every step."""
        state = self.state
        timed = False  # a process's first step compiles kernels
        while self.progress < 1.0:
            begun, self.between_steps = time.perf_counter(), False
            parts = self.step()
            self._refuse_nan(parts)
            state.seconds += self.group.of_first(time.perf_counter() - begun) * timed
            state.step, timed = state.step + 1, True
            if state.step % 10 == 0 and parts:  # a GPU returns none until its first step has finished
                rounded = {name: float(f"{value:.4g}") for name, value in parts.items()}
                state.curve.append({"step": state.step, "seconds": round(state.seconds, 2), **rounded})
            self.between_steps = True
            on_step(self)
        self._refuse_nan(self.engine.settle())

    def _refuse_nan(self, parts: dict[str, float]) -> None:
        if not all(math.isfinite(value) for value in parts.values()):
            raise Diverged(f"step {self.state.step}: the loss is not finite ({parts})")

    def checkpoint(self) -> tuple[dict, dict[str, np.ndarray]]:
        """Return (JSON, arrays) to resume from."""
        arrays = {f"field.{k}": v for k, v in self.field.arrays().items()} | self.engine.moments()
        return {"state": vars(self.state)}, {k: v.copy() for k, v in arrays.items()}

    def resume(self, data: dict, arrays: dict[str, np.ndarray]) -> None:
        """Restore a checkpoint() from any device."""
        self.state = FineTuneState(**data["state"])
        for name, own in self.field.arrays().items():
            own[:] = arrays[f"field.{name}"]
        self.engine.resume(arrays)


def _overlap(own: slice, begin: int, count: int) -> slice:
    """Return which of `count` rays, starting at index `begin` of a step, are in `own`; relative to `begin`."""
    return slice(min(max(own.start - begin, 0), count), min(max(own.stop - begin, 0), count))
