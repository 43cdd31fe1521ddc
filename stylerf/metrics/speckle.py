"""Speckle: pixels that differ from all of their neighbors.

    s = sqrt(mean over pixels and channels of e^2),   e = how far a value is outside the range of its 8 neighbors

Lines one pixel wide, edges, corners and gradients have e = 0 except at their ends; a single outlier pixel of height h
adds h^2. White noise with standard deviation sigma gives s = 0.34 sigma.
"""

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter

from stylerf.errors import InvalidValue

NEIGHBORS = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], bool)


def speckle(image: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Return the root mean square by which values are outside the range of their 8 neighbors: 0 (none) to 1.

    Args:
        image: [h, w, 3], sRGB 0..1.
        mask: [h, w] bool; a pixel counts if it and all of its neighbors are set. None for all. Border pixels never
            count.

    Raises:
        InvalidValue: No pixel counts, or a value that counts is not finite.
    """
    if image.ndim != 3 or image.shape[2] != 3:
        raise InvalidValue(f"expected an image [h, w, 3], got an array of shape {image.shape}")
    inner = np.zeros(image.shape[:2], bool)
    inner[1:-1, 1:-1] = True
    if mask is not None:
        inner &= minimum_filter(np.asarray(mask, bool), size=3, mode="nearest")
    if not inner.any():
        raise InvalidValue("no pixel has all of its neighbors in the mask")
    values = np.asarray(image, np.float64)
    around = NEIGHBORS[..., None]
    above = values - maximum_filter(values, footprint=around, mode="nearest")
    below = minimum_filter(values, footprint=around, mode="nearest") - values
    outside = np.maximum(np.maximum(above, below), 0)[inner]
    if not np.isfinite(outside).all():
        raise InvalidValue("values of the image are not finite")
    return float(np.sqrt(np.square(outside).mean()))
