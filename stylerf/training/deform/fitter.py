"""Initialize a deformation on the photos before a stylization changes it (DeSRF, section 3.2, L_init)."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from stylerf.errors import Diverged
from stylerf.fields.deformation import Deformation
from stylerf.fields.radiance_field import RadianceField
from stylerf.training.common.ray_dataset import RayDataset, psnr_from_mse, shown_rays
from stylerf.training.deform.deformer import AnyDeformer, Deformer, PhotoError

if TYPE_CHECKING:
    from stylerf.training.deform.deformer_gpu import GpuPhotoError

PhotoErrors: TypeAlias = "PhotoError | GpuPhotoError"
DeformBackend = tuple[Callable[..., AnyDeformer], Callable[..., PhotoErrors]]
FIXED_RAYS = 8192
LOOK_EVERY = 200  # steps


@dataclass(frozen=True)
class DeformSettings:
    """Settings of the initialization.

    Attributes:
        steps, rays: Maximum number of steps, and random rays per step.
        rate: Learning rate; decays to a tenth.
        smoothness: Weight of the displacement's total variation.
        vertices: Vertices per side of the displacement grid.
        background: Gray level behind the field.
        patience: Gain in dB on fixed rays between two evaluations required to continue (0: always continue).
        gate: Total gain in dB on them below which the deformation is dropped (0: keep the best).
    """

    steps: int = 2000
    rays: int = 1024
    rate: float = 1e-3
    smoothness: float = 1.0
    vertices: int = 32
    background: float = 1.0
    weight_threshold: float = 0.1
    patience: float = 0.02
    gate: float = 0.0


@dataclass
class DeformState:
    """Progress of the initialization."""

    step: int = 0
    seconds: float = 0.0
    before: float = 0.0  # dB on the fixed rays, undeformed
    best: float = 0.0
    settled: bool = False
    curve: list[dict] = field(default_factory=list)


class DeformationFitter:
    """Fits a deformation to the photos; the scene's density and colors are fixed.

    held_out: number of last views used for evaluation instead of training. backend: implementation of deformer and
    photo error, by default on the CPU (training/backends.py); all draw the same rays.
    """

    def __init__(
        self,
        scene: RadianceField,
        deformation: Deformation,
        dataset: RayDataset,
        settings: DeformSettings,
        seed: int,
        threads: int,
        held_out: int = 0,
        backend: DeformBackend = (Deformer, PhotoError),
    ) -> None:
        self.field, self.dataset, self.settings, self.seed = scene, dataset, settings, seed
        new_deformer, new_error = backend
        self.deformer = new_deformer(scene, deformation, dataset.cameras, settings.vertices, seed, threads)
        self._error = new_error(self.deformer, settings.background, settings.weight_threshold, threads)
        self.among = len(dataset.cameras) - held_out
        self._fixed = self._fixed_rays(np.random.default_rng([seed, 9]))
        self.state = DeformState()
        self.state.before = self.state.best = self.quality()
        self._best, self._rest = deformation.values.copy(), deformation.values.copy()
        self.between_steps = True

    def _fixed_rays(self, generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return rays of the held-out views, or of all views if none is held out."""
        if self.among == len(self.dataset.cameras):
            rays = self.dataset.draw(FIXED_RAYS, generator)[:3]
        else:
            rays = self.dataset.of_views(self.among, FIXED_RAYS, generator)
        return shown_rays(*rays) if self.field.opaque_background else rays

    @property
    def dropped(self) -> bool:
        """Whether the deformation has gained too little so far."""
        return self.settings.gate > 0 and self.state.best < self.state.before + self.settings.gate

    def quality(self) -> float:
        """Return the PSNR over a fixed set of rays, dB."""
        return psnr_from_mse(self._error.of(*self._fixed))

    def step(self) -> tuple[float, float]:
        """Take one step; return the mean squared error and the root mean square displacement (cube two units wide).

        On a GPU, both are from a few steps before.
        """
        settings, state = self.settings, self.state
        generator = np.random.default_rng([self.seed, 6, state.step])
        drawn = self.dataset.draw(settings.rays, generator, self.among)[:3]
        error = self._error.learn(*drawn, generator.random(settings.rays, dtype=np.float32))
        # By steps, not by time: a resumed or slower run follows the same schedule.
        rate = settings.rate * 0.1 ** (state.step / max(1, settings.steps))
        size = self.deformer.step(rate, 0.0, settings.smoothness)
        state.step += 1
        return error, size

    def run(self, on_step: Callable[["DeformationFitter"], None] = lambda fitter: None) -> None:
        """Train until the steps are used up or stop helping; ends with the best deformation, or with none."""
        state = self.state
        while state.step < self.settings.steps and not state.settled:
            begun, self.between_steps = time.perf_counter(), False
            error, size = self.step()
            if not math.isfinite(error + size):
                raise Diverged(f"step {state.step} of the deformation: the loss is not finite")
            if state.step % LOOK_EVERY == 0 or state.step == self.settings.steps:
                self._look(size)
            state.seconds += time.perf_counter() - begun
            self.between_steps = True
            on_step(self)
        # The last step need not be the best, and some scenes gain nothing from any deformation.
        self.deformer.take(self._rest if self.dropped else self._best)

    def _look(self, size: float) -> None:
        state, quality = self.state, self.quality()
        state.curve.append({"step": state.step, "psnr": round(quality, 3), "displacement": round(size, 5)})
        state.settled = self.settings.patience > 0 and quality < state.best + self.settings.patience
        if quality > state.best:
            state.best, self._best = quality, self.deformer.values()

    def checkpoint(self) -> tuple[dict, dict[str, np.ndarray]]:
        """Return (JSON, arrays) to resume from."""
        return {"state": vars(self.state)}, {**self.deformer.arrays(), "best": self._best}

    def resume(self, data: dict, arrays: dict[str, np.ndarray]) -> None:
        """Restore a checkpoint()."""
        self.state = DeformState(**data["state"])
        self.deformer.restore(arrays)
        self._best = arrays["best"].copy()
