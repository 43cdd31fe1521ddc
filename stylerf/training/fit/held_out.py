"""The rays used to evaluate a fit."""

from collections.abc import Callable

import numpy as np

from stylerf.training.common.ray_dataset import RayDataset, background_of, over, psnr_from_mse, shown_rays, target

RAYS = 16384


class HeldOutRays:
    """Random rays of a dataset's last `held_out` views, or of all views if none is held out.

    opaque: whether the space has an opaque background, where masked rays have no color to compare (decision 0004).
    """

    def __init__(self, dataset: RayDataset, held_out: int, opaque: bool, background: str, seed: int) -> None:
        self._dataset, self._held_out, self._opaque, self._seed = dataset, held_out, opaque, seed
        # Cut-out objects are evaluated over random colors: over white, a missing white object would go unnoticed.
        self._background = "random" if dataset.channels == 4 else background
        self.choose()

    def choose(self) -> None:
        """Update the rays' colors to the photos' current exposure; the rays are the same each time."""
        first = len(self._dataset.cameras) - self._held_out if self._held_out else 0
        chosen = self._dataset.of_views(first, RAYS, np.random.default_rng([self._seed, 3]))
        self.rays = shown_rays(*chosen) if self._opaque else chosen

    def psnr(self, rendered: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> float:
        """Return the PSNR, dB. rendered: maps origins and directions [n, 3] to pixels [n, 5]."""
        origins, directions, colors = self.rays
        background = background_of(self._background, len(origins), np.random.default_rng([self._seed, 4]))
        out = rendered(origins, directions)
        error = np.clip(over(out[:, :3], out[:, 3:4], background) - target(colors, background), -1, 1)
        return psnr_from_mse(float(np.square(error).mean(dtype=np.float64)))
