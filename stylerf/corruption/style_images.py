"""Style images on which stylizations fail: blank, tiny, huge, without edges, with extreme colors.

Each is [h, w, 3] float32, sRGB 0..1, bit-identical for the same seed.
"""

import numpy as np
from scipy.ndimage import gaussian_filter, zoom

from stylerf.procedural.painting import paint

REVISION = 1  # increment if a seed gives a different image than before, here or in `paint`
WHITE = 1.0
RED, BLUE = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)


def ordinary(side: int, seed: int) -> np.ndarray:
    """Return the procedural painting, the baseline of all faults."""
    return paint(side, seed)


def white(side: int) -> np.ndarray:
    """Return a white image."""
    return np.full((side, side, 3), WHITE, np.float32)


def tiny(side: int, seed: int) -> np.ndarray:
    """Return the painting as an icon of `side` pixels, by area averaging."""
    whole = paint(max(32, 16 * side), seed)
    block = len(whole) // side
    return whole[: side * block, : side * block].reshape(side, block, side, block, 3).mean((1, 3)).astype(np.float32)


def huge(side: int, seed: int) -> np.ndarray:
    """Return the painting as a scan of `side` pixels: painted at a quarter (at most 512), enlarged, with grain."""
    small = paint(min(512, max(32, side // 4)), seed)
    factor = side / len(small)
    large = zoom(small, (factor, factor, 1), order=1, grid_mode=True, mode="nearest")  # float32, as `small` is
    grain = np.random.default_rng([seed, 7]).standard_normal((*large.shape[:2], 1), dtype=np.float32)
    return np.clip(large + np.float32(0.02) * grain, 0, 1)


def weak_geometry(side: int, seed: int) -> np.ndarray:
    """Return a wash of smooth color gradients without edges, which DeSRF names as its limitation."""
    noise = np.random.default_rng([seed, 8]).standard_normal((side, side, 3))
    smooth = gaussian_filter(noise, (side / 6, side / 6, 0), mode="wrap")
    low, high = smooth.min((0, 1)), smooth.max((0, 1))
    return (0.15 + 0.7 * (smooth - low) / (high - low)).astype(np.float32)


def extreme_palette(side: int, seed: int) -> np.ndarray:
    """Return blobs of saturated red and blue with hard edges: every color is a corner of the RGB cube."""
    noise = gaussian_filter(np.random.default_rng([seed, 9]).standard_normal((side, side)), side / 24, mode="wrap")
    return np.where((noise > np.median(noise))[..., None], RED, BLUE).astype(np.float32)
