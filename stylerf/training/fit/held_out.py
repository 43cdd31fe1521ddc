"""The rays by which a fit is judged."""

from collections.abc import Callable

import numpy as np

from stylerf.training.common.ray_dataset import RayDataset, background_of, over, psnr_from_mse, shown_rays, target

RAYS = 16384


class HeldOutRays:
    """Random rays of the last `held_out` views of a dataset; of all views if none is held out.

    opaque: the space has an opaque background, so that masked rays have no color to compare with (decision 0004).
    """

    def __init__(self, dataset: RayDataset, held_out: int, opaque: bool, background: str, seed: int) -> None:
        self._dataset, self._held_out, self._opaque, self._seed = dataset, held_out, opaque, seed
        # A cut-out object is judged over random colors: over white, a missing white object would count as found.
        self._background = "random" if dataset.channels == 4 else background
        self.choose()

    def choose(self) -> None:
        """Take the rays' colors at the photos' present exposure; the same rays each time."""
        first = len(self._dataset.cameras) - self._held_out if self._held_out else 0
        chosen = self._dataset.of_views(first, RAYS, np.random.default_rng([self._seed, 3]))
        self.rays = shown_rays(*chosen) if self._opaque else chosen

    def psnr(self, rendered: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> float:
        """PSNR, dB, of pixels [n, 5] rendered from origins and directions [n, 3]."""
        origins, directions, colors = self.rays
        background = background_of(self._background, len(origins), np.random.default_rng([self._seed, 4]))
        out = rendered(origins, directions)
        error = np.clip(over(out[:, :3], out[:, 3:4], background) - target(colors, background), -1, 1)
        return psnr_from_mse(float(np.square(error).mean(dtype=np.float64)))
