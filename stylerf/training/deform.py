"""Deformation initialised on the photos before a stylisation moves it (DeSRF, section 3.2, L_init)."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from stylerf.errors import Diverged
from stylerf.fields.deformation import Deformation
from stylerf.fields.field import RadianceField
from stylerf.fields.samples import Rays
from stylerf.rendering.rays import backward, render_rays
from stylerf.training.deformer import Deformer
from stylerf.training.rays import RayBank


@dataclass(frozen=True)
class DeformSettings:
    """steps of `rays` random rays; smoothness: weight of the displacement's total variation; vertices: side of the grid
    that the deformation is baked to; rate falls to a tenth. background: level of grey behind the field."""

    steps: int = 2000
    rays: int = 1024
    rate: float = 1e-3
    smoothness: float = 1.0
    vertices: int = 32
    background: float = 1.0
    share: float = 0.1


@dataclass
class DeformState:
    """Where the initialisation stands."""

    step: int = 0
    seconds: float = 0.0
    curve: list[dict] = field(default_factory=list)


class DeformationFitter:
    """The scene's density and colours stay; the deformation learns to explain what they leave of the photos."""

    def __init__(
        self,
        scene: RadianceField,
        deformation: Deformation,
        bank: RayBank,
        settings: DeformSettings,
        seed: int,
        chunks: int,
    ) -> None:
        self.field, self.bank, self.settings, self.seed, self.chunks = scene, bank, settings, seed, chunks
        self.deformer = Deformer(scene, deformation, bank.cameras, settings.vertices, seed, chunks)
        self.state = DeformState()
        self.between_steps = True

    def step(self) -> tuple[float, float]:
        """One step; mean squared error and root mean square of the displacement (cube two units wide)."""
        settings, state = self.settings, self.state
        generator = np.random.default_rng([self.seed, 6, state.step])
        origins, directions, colours, _ = self.bank.draw(settings.rays, generator)
        rays = Rays.of(origins, directions, self.field.space.near, generator.random(settings.rays, dtype=np.float32))
        rendered = render_rays(self.field, rays, chunks=self.chunks, share=settings.share)
        back = np.float32(settings.background)
        target = colours[:, :3] * colours[:, 3:] + (1 - colours[:, 3:]) * back
        difference = rendered.out[:, :3] + (1 - rendered.out[:, 3:4]) * back - target
        gradients = np.zeros_like(rendered.out)
        gradients[:, :3] = difference * np.float32(2 / difference.size)
        gradients[:, 3] = -gradients[:, :3].sum(1) * back
        backward(self.field, rendered, gradients, None, None, self.deformer.gradients)
        rate = settings.rate * 0.1 ** (state.step / max(1, settings.steps))
        size = self.deformer.step(rate, 0.0, settings.smoothness)
        state.step += 1
        return float(np.square(difference).mean()), size

    def run(self, on_step: Callable[["DeformationFitter"], None] = lambda fitter: None) -> None:
        """All steps; on_step is told after each."""
        state, errors = self.state, []
        while state.step < self.settings.steps:
            begun, self.between_steps = time.perf_counter(), False
            error, size = self.step()
            if not math.isfinite(error + size):
                raise Diverged(f"step {state.step} of the deformation: the loss left the finite numbers")
            state.seconds += time.perf_counter() - begun
            errors.append(error)
            if state.step % 100 == 0:
                level = -10 * math.log10(max(float(np.mean(errors)), 1e-12))
                state.curve.append({"step": state.step, "psnr": round(level, 3), "displacement": round(size, 5)})
                errors.clear()
            self.between_steps = True
            on_step(self)

    def checkpoint(self) -> tuple[dict, dict[str, np.ndarray]]:
        """(JSON, arrays) to go on from."""
        return {"state": vars(self.state)}, self.deformer.arrays()

    def resume(self, data: dict, arrays: dict[str, np.ndarray]) -> None:
        """From checkpoint()."""
        self.state = DeformState(**data["state"])
        self.deformer.restore(arrays)
