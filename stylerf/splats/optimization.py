"""Optimize 3D Gaussians on images, with Adam and the rasterizer's gradients (Kerbl et al. 2023).

Centers move in units of each Gaussian's size, so one learning rate suits near and far ones. No Gaussian may outgrow the
spacing at which it was placed or become a needle, since both would be visible between training views.
"""

import numpy as np

from stylerf.geometry.cameras import Camera
from stylerf.kernels.cpu.splats import Gaussians
from stylerf.splats.rasterizer import splat, splat_backward
from stylerf.training.common.adam import Adam

CENTER_RATE, SCALE_RATE, TURN_RATE, OPACITY_RATE, COLOR_RATE = 0.1, 0.05, 0.01, 0.1, 0.04
LAST_RATE = 0.1  # of the first; rates fall exponentially
SHARED_BANDS = 0.2  # learning rate of higher bands, relative to the constant one
EDGE = 0.05  # of the color range: smaller errors are squared, larger ones count linearly (Charbonnier)
WIDEST, NARROWEST = 4.0, 0.05  # standard deviations, relative to a Gaussian's initial one
LONGEST = 4.0  # maximum standard deviation, relative to the second largest
LIMITED_EVERY = 8  # steps
FAINTEST = 0.02  # opacity below which a Gaussian is dropped at the end


class SplatOptimizer:
    """Gaussians and their Adam moments.

    Args:
        gaussians: initial values.
        near: minimum depth at which Gaussians are rendered, scene units.
        threads: number of threads; the result does not depend on it.
    """

    def __init__(self, gaussians: Gaussians, near: float, threads: int) -> None:
        self.near, self.threads, self.steps = near, threads, 0
        self.gaussians = Gaussians(*(np.array(values, np.float32) for values in gaussians))
        self._sizes = np.exp(gaussians.log_scales).max(1, keepdims=True).astype(np.float32)
        self._start = gaussians.centers.astype(np.float32)
        self._offsets = np.zeros_like(self._start)
        g, bands = self.gaussians, gaussians.harmonics.shape[1]
        color = np.full((1, bands, 1), COLOR_RATE * SHARED_BANDS, np.float32)
        color[:, 0] = COLOR_RATE
        # One learning rate per array, so higher bands are trained in scaled units.
        self._units = color / COLOR_RATE
        self._colors = g.harmonics / self._units
        arrays = self._offsets, g.log_scales, g.quaternions, g.logits, self._colors
        rates = CENTER_RATE, SCALE_RATE, TURN_RATE, OPACITY_RATE, COLOR_RATE
        self._adams = [Adam(a.reshape(-1), [(0, a.size, rate)], 1) for a, rate in zip(arrays, rates, strict=True)]
        self._gradients = Gaussians(
            *(adam.gradients[0].reshape(a.shape) for adam, a in zip(self._adams, arrays, strict=True))
        )

    def step(self, camera: Camera, target: np.ndarray, progress: float) -> float:
        """Take one step towards a target image.

        Args:
            target: [h, w, 4] float32: premultiplied rgb, sRGB-encoded, and alpha, so that empty space stays empty.
            progress: 0..1, completed fraction of the optimization.

        Returns:
            Mean squared error of rgb before the step.
        """
        drawn = splat(self.gaussians, camera, near=self.near, threads=self.threads)
        difference = drawn.image - target
        gradients = difference / np.sqrt(difference * difference + np.float32(EDGE * EDGE))
        splat_backward(self.gaussians, drawn, gradients, self._gradients, self.threads)
        self._gradients.centers[:] *= self._sizes
        self._gradients.harmonics[:] *= self._units
        for adam in self._adams:
            adam.step(LAST_RATE**progress)
        self.gaussians.centers[:] = self._start + self._sizes * self._offsets
        self.gaussians.harmonics[:] = self._colors * self._units
        self.steps += 1
        if self.steps % LIMITED_EVERY == 0:
            self._limit()
        return float(np.mean(difference[..., :3] ** 2))

    def result(self) -> Gaussians:
        """Return the Gaussians that are not too faint, with unit quaternions."""
        self._limit()
        g = self.gaussians
        kept = g.logits > np.log(FAINTEST / (1 - FAINTEST))
        lengths = np.linalg.norm(g.quaternions, axis=1, keepdims=True)
        turned = g._replace(quaternions=g.quaternions / np.maximum(lengths, 1e-12))
        return Gaussians(*(values[kept] for values in turned))

    def _limit(self) -> None:
        """Clamp scales to their limits."""
        scales, sizes = self.gaussians.log_scales, np.log(self._sizes)
        np.clip(scales, sizes + np.log(NARROWEST), sizes + np.log(WIDEST), out=scales)
        second = np.sort(scales, axis=1)[:, 1:2]
        np.minimum(scales, second + np.float32(np.log(LONGEST)), out=scales)
