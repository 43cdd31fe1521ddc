"""Error of a deforming field on the photos, and what it teaches the deformation."""

import numpy as np

from stylerf.fields.marching import ScratchArena
from stylerf.kernels.cpu.ray_samples import Rays
from stylerf.rendering.rays import Rendered, backward, render_rays
from stylerf.training.common.ray_dataset import unhidden
from stylerf.training.deform.deformer import Deformer


class PhotoError:
    """Mean squared error of a deforming field's rays, and its gradient.

    background: gray level behind the field. weight_threshold: see render_rays.
    """

    def __init__(self, deformer: Deformer, background: float, weight_threshold: float, threads: int) -> None:
        self.deformer, self.background, self.threads = deformer, np.float32(background), threads
        self.weight_threshold = weight_threshold
        self._memory = ScratchArena()

    def _rendered(self, origins, directions, colors, jitter=None) -> tuple[Rendered, np.ndarray]:
        """Rendered rays, and their difference from the photos over the background."""
        field, back = self.deformer.field, self.background
        rays = Rays.of(origins, directions, field.space.near, jitter)
        threshold, arena = self.weight_threshold, self._memory.reset()
        rendered = render_rays(field, rays, threads=self.threads, weight_threshold=threshold, arena=arena)
        found = rendered.out[:, :3] + (1 - rendered.out[:, 3:4]) * back
        if field.opaque_background:
            colors = unhidden(colors, found)
        target = colors[:, :3] * colors[:, 3:] + (1 - colors[:, 3:]) * back
        return rendered, found - target

    def of(self, origins: np.ndarray, directions: np.ndarray, colors: np.ndarray) -> float:
        """Mean squared error of rays, marched from the middle of their first step, to straight rgba [n, 4]."""
        return float(np.square(self._rendered(origins, directions, colors)[1]).mean())

    def learn(self, origins: np.ndarray, directions: np.ndarray, colors: np.ndarray, jitter: np.ndarray) -> float:
        """Add dL/dD of rays' mean squared error to the deformer's gradients; returns the error."""
        rendered, difference = self._rendered(origins, directions, colors, jitter)
        gradients = np.zeros_like(rendered.out)
        gradients[:, :3] = difference * np.float32(2 / difference.size)
        gradients[:, 3] = -gradients[:, :3].sum(1) * self.background
        backward(self.deformer.field, rendered, gradients, None, None, self.deformer.gradients)
        return float(np.square(difference).mean())
