"""Paintings that stylizations fail on: without content, tiny, huge, without geometry, of extreme colors.

Each is [h, w, 3] float32, sRGB 0..1, the same bits for the same seed.
"""

import numpy as np
from scipy.ndimage import gaussian_filter, zoom

from stylerf.procedural.painting import paint

REVISION = 1  # of these and of `paint`: raise it where a seed gives another painting than before
WHITE = 1.0
RED, BLUE = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)


def ordinary(side: int, seed: int) -> np.ndarray:
    """The procedural painting, what every fault is set beside."""
    return paint(side, seed)


def white(side: int) -> np.ndarray:
    """A sheet of paper: colors without spread, features without direction."""
    return np.full((side, side, 3), WHITE, np.float32)


def tiny(side: int, seed: int) -> np.ndarray:
    """The painting as an icon of `side` pixels: every pixel averages what it covers."""
    whole = paint(max(32, 16 * side), seed)
    block = len(whole) // side
    return whole[: side * block, : side * block].reshape(side, block, side, block, 3).mean((1, 3)).astype(np.float32)


def huge(side: int, seed: int) -> np.ndarray:
    """The painting as a scan of `side` pixels: a quarter of it, 512 at most, enlarged, and grain."""
    small = paint(min(512, max(32, side // 4)), seed)
    factor = side / len(small)
    large = zoom(small, (factor, factor, 1), order=1, grid_mode=True, mode="nearest")  # float32, as `small` is
    grain = np.random.default_rng([seed, 7]).standard_normal((*large.shape[:2], 1), dtype=np.float32)
    return np.clip(large + np.float32(0.02) * grain, 0, 1)


def weak_geometry(side: int, seed: int) -> np.ndarray:
    """A wash: colors that flow into one another over half the picture, and no edge anywhere (DeSRF's stated limit)."""
    noise = np.random.default_rng([seed, 8]).standard_normal((side, side, 3))
    smooth = gaussian_filter(noise, (side / 6, side / 6, 0), mode="wrap")
    low, high = smooth.min((0, 1)), smooth.max((0, 1))
    return (0.15 + 0.7 * (smooth - low) / (high - low)).astype(np.float32)


def extreme_palette(side: int, seed: int) -> np.ndarray:
    """Blots of full red and full blue with hard edges: every color lies on a corner of the cube."""
    noise = gaussian_filter(np.random.default_rng([seed, 9]).standard_normal((side, side)), side / 24, mode="wrap")
    return np.where((noise > np.median(noise))[..., None], RED, BLUE).astype(np.float32)
