"""Roughness of a style image: how much fine brushwork, hatching, canvas or paper it has, a pixel or two wide."""

import numpy as np
from scipy.ndimage import median_filter
from torch import Tensor

from stylerf.srgb import LUMA
from stylerf.style.style_features import stroke_picture

MOST_PIXELS = 2_000_000  # per image; beyond that, bands of it represent the whole


def roughness(style_image: Tensor, long_side: int, stroke: float = 1.0) -> float:
    """Return the mean absolute difference of luma from the median of its 3x3 neighbors: 0 (smooth) to 1.

    A smooth painting has less than 0.01, a woodcut or stained glass 0.02, thick paint on canvas 0.05 and more.

    Args:
        style_image: [3, h, w] or [4, h, w], sRGB 0..1; pixels with alpha below one half are ignored.
        long_side, stroke: The size at which to evaluate it; see stroke_picture().
    """
    picture = stroke_picture(style_image, long_side, stroke).numpy()
    among = -(-picture[0].size // MOST_PIXELS)  # use one band in this many
    bands = np.array_split(picture, 8 * among, axis=1)[::among] if among > 1 else [picture]
    found = []
    for band in bands:
        luma = np.tensordot(np.asarray(LUMA, np.float32), band[:3], 1)
        fine = np.abs(luma - median_filter(luma, 3))
        found.append(fine[band[3] >= 0.5] if len(band) == 4 else fine.ravel())
    values = np.concatenate(found)
    return float(values.mean()) if values.size else 0.0
