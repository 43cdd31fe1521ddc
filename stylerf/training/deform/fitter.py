"""Deformation initialized on the photos before a stylization moves it (DeSRF, section 3.2, L_init)."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from stylerf.errors import Diverged
from stylerf.fields.deformation import Deformation
from stylerf.fields.radiance_field import RadianceField
from stylerf.fields.scratch_arena import ScratchArena
from stylerf.kernels.cpu.ray_samples import Rays
from stylerf.rendering.rays import Rendered, backward, render_rays
from stylerf.training.common.pixels import psnr_from_mse
from stylerf.training.common.ray_dataset import RayDataset, shown_rays, unhidden
from stylerf.training.deform.backend import deformer_on
from stylerf.training.deform.deformer import Deformer

FIXED_RAYS = 8192
LOOK_EVERY = 200  # steps


@dataclass(frozen=True)
class DeformSettings:
    """steps of `rays` random rays; smoothness: weight of the displacement's total variation; vertices: side of the grid
    that the deformation is baked to; rate falls to a tenth. background: level of gray behind the field. patience: dB
    that a fixed set of the photos' rays must gain between two looks for the training to go on (0: always). gate: dB
    that they must gain in all, else the deformation is dropped (0: what is best on them is kept)."""

    steps: int = 2000
    rays: int = 1024
    rate: float = 1e-3
    smoothness: float = 1.0
    vertices: int = 32
    background: float = 1.0
    share: float = 0.1
    patience: float = 0.02
    gate: float = 0.0


@dataclass
class DeformState:
    """Where the initialization stands."""

    step: int = 0
    seconds: float = 0.0
    before: float = 0.0  # dB on the fixed rays, at rest
    best: float = 0.0
    settled: bool = False
    curve: list[dict] = field(default_factory=list)


class PhotoError:
    """How far rays through a deforming field are from the photos, and what that teaches the deformation.

    background: level of gray behind the field. share: as render_rays takes it.
    """

    def __init__(self, deformer: Deformer, background: float, share: float, chunks: int) -> None:
        self.deformer, self.background, self.share, self.chunks = deformer, np.float32(background), share, chunks
        self._memory = ScratchArena()

    def _rendered(self, origins, directions, colors, jitter=None) -> tuple[Rendered, np.ndarray]:
        """What rays come back with, and its difference from the photos over the background."""
        field, back = self.deformer.field, self.background
        rays = Rays.of(origins, directions, field.space.near, jitter)
        arena = self._memory.reset()
        rendered = render_rays(field, rays, threads=self.chunks, weight_threshold=self.share, arena=arena)
        found = rendered.out[:, :3] + (1 - rendered.out[:, 3:4]) * back
        if field.opaque_background:
            colors = unhidden(colors, found)
        target = colors[:, :3] * colors[:, 3:] + (1 - colors[:, 3:]) * back
        return rendered, found - target

    def of(self, origins: np.ndarray, directions: np.ndarray, colors: np.ndarray) -> float:
        """Mean squared difference of rays, marched from the middle of their first step, from straight rgba [n, 4]."""
        return float(np.square(self._rendered(origins, directions, colors)[1]).mean())

    def learn(self, origins: np.ndarray, directions: np.ndarray, colors: np.ndarray, jitter: np.ndarray) -> float:
        """Add dL/dD of their mean squared difference to the deformer's gradients; the difference itself."""
        rendered, difference = self._rendered(origins, directions, colors, jitter)
        gradients = np.zeros_like(rendered.out)
        gradients[:, :3] = difference * np.float32(2 / difference.size)
        gradients[:, 3] = -gradients[:, :3].sum(1) * self.background
        backward(self.deformer.field, rendered, gradients, None, None, self.deformer.gradients)
        return float(np.square(difference).mean())


class DeformationFitter:
    """The scene's density and colors stay; the deformation learns to explain what they leave of the photos.

    held_out: so many last views of the bank teach nothing and are looked at instead of a fixed set of all rays.
    device: where it is learned; None: by the CPU's kernels. The same rays are drawn everywhere.
    """

    def __init__(
        self,
        scene: RadianceField,
        deformation: Deformation,
        bank: RayDataset,
        settings: DeformSettings,
        seed: int,
        chunks: int,
        held_out: int = 0,
        device: str | None = None,
    ) -> None:
        self.field, self.bank, self.settings, self.seed, self.chunks = scene, bank, settings, seed, chunks
        self.deformer = deformer_on(device, scene, deformation, bank.cameras, settings.vertices, seed, chunks)
        self._error = self._error_on(device)
        self.among = len(bank.cameras) - held_out
        self._fixed = self._fixed_rays(np.random.default_rng([seed, 9]))
        self.state = DeformState()
        self.state.before = self.state.best = self.quality()
        self._best, self._rest = deformation.values.copy(), deformation.values.copy()
        self.between_steps = True

    def _error_on(self, device: str | None) -> PhotoError:
        if device is None:
            return PhotoError(self.deformer, self.settings.background, self.settings.share, self.chunks)
        from stylerf.training.deform.deformer_gpu import GpuPhotoError

        return GpuPhotoError(self.deformer, self.settings.background, self.settings.share)

    def _fixed_rays(self, generator: np.random.Generator):
        """Rays of the views kept aside, of all where none is."""
        views = len(self.bank.cameras)
        if self.among == views:
            rays = self.bank.draw(FIXED_RAYS, generator)[:3]
        else:
            chosen = generator.integers(self.among, views, FIXED_RAYS)
            rays = self.bank.at(chosen, (generator.random(FIXED_RAYS) * self.bank.sizes[chosen]).astype(np.int64))
        return shown_rays(*rays) if self.field.opaque_background else rays

    @property
    def dropped(self) -> bool:
        """Whether the deformation has not paid for itself, as far as it has come."""
        return self.settings.gate > 0 and self.state.best < self.state.before + self.settings.gate

    def quality(self) -> float:
        """PSNR over a fixed set of the photos' rays, dB."""
        return psnr_from_mse(self._error.of(*self._fixed))

    def step(self) -> tuple[float, float]:
        """One step; mean squared error and root mean square of the displacement (cube two units wide).

        On a device both are those of a step or a few before.
        """
        settings, state = self.settings, self.state
        generator = np.random.default_rng([self.seed, 6, state.step])
        drawn = self.bank.draw(settings.rays, generator, self.among)[:3]
        error = self._error.learn(*drawn, generator.random(settings.rays, dtype=np.float32))
        rate = settings.rate * 0.1 ** (state.step / max(1, settings.steps))
        size = self.deformer.step(rate, 0.0, settings.smoothness)
        state.step += 1
        return error, size

    def run(self, on_step: Callable[["DeformationFitter"], None] = lambda fitter: None) -> None:
        """Steps until they are used up or gain nothing; the field ends with the best deformation seen, or with none."""
        state = self.state
        while state.step < self.settings.steps and not state.settled:
            begun, self.between_steps = time.perf_counter(), False
            error, size = self.step()
            if not math.isfinite(error + size):
                raise Diverged(f"step {state.step} of the deformation: the loss left the finite numbers")
            if state.step % LOOK_EVERY == 0 or state.step == self.settings.steps:
                self._look(size)
            state.seconds += time.perf_counter() - begun
            self.between_steps = True
            on_step(self)
        self.deformer.take(self._rest if self.dropped else self._best)

    def _look(self, size: float) -> None:
        state, quality = self.state, self.quality()
        state.curve.append({"step": state.step, "psnr": round(quality, 3), "displacement": round(size, 5)})
        state.settled = self.settings.patience > 0 and quality < state.best + self.settings.patience
        if quality > state.best:
            state.best, self._best = quality, self.deformer.values()

    def checkpoint(self) -> tuple[dict, dict[str, np.ndarray]]:
        """(JSON, arrays) to go on from."""
        return {"state": vars(self.state)}, {**self.deformer.arrays(), "best": self._best}

    def resume(self, data: dict, arrays: dict[str, np.ndarray]) -> None:
        """From checkpoint()."""
        self.state = DeformState(**data["state"])
        self.deformer.restore(arrays)
        self._best = arrays["best"].copy()
