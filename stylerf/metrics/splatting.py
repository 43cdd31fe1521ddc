"""Softmax splatting (Niklaus and Liu 2020): forward warping in which more important pixels cover others.

    warped(q) = sum_p b(q - p - F(p)) exp(Z(p)) I(p) / sum_p b(q - p - F(p)) exp(Z(p))

with b the bilinear weight max(0, 1 - |dx|) max(0, 1 - |dy|) and Z the importance of a pixel.
"""

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.metrics.optical_flow import check_flow, sampled

IMPORTANCE = -20.0  # factor of the photometric error, from the authors' example


def softmax_splat(image: np.ndarray, flow: np.ndarray, importance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Splat an image along a flow.

    Args:
        image: [h, w, c].
        flow: [h, w, 2]; pixels of unknown flow, and those that leave the image, are dropped.
        importance: Z, [h, w].

    Returns:
        The warped image [h, w, c], 0 where nothing lands, and where something lands, [h, w] bool.
    """
    height, width, channels = image.shape
    check_flow(flow, (height, width))
    if importance.shape != (height, width):
        raise InvalidValue(f"importance {importance.shape} does not fit an image of {image.shape}")
    known = np.isfinite(flow).all(axis=-1).reshape(-1)
    rows, columns = np.divmod(np.flatnonzero(known), width)
    move = flow.reshape(-1, 2)[known]
    x, y = np.clip(columns + move[:, 0], -2, width + 1), np.clip(rows + move[:, 1], -2, height + 1)
    left, top = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    colors = np.asarray(image, np.float64).reshape(-1, channels)[known]
    strength = np.asarray(importance, np.float64).reshape(-1)[known]
    weight = np.exp(strength - strength.max(initial=-np.inf))  # the maximum cancels in the quotient
    total, found = np.zeros(height * width), np.zeros((height * width, channels))
    landed = np.zeros(height * width, bool)
    for down in (0, 1):
        for right in (0, 1):
            i, j = top + down, left + right
            share = (1 - np.abs(x - j)) * (1 - np.abs(y - i))
            lands = (i >= 0) & (i < height) & (j >= 0) & (j < width) & (share > 0)
            place, part = i[lands] * width + j[lands], share[lands] * weight[lands]
            landed[place] = True
            total += np.bincount(place, part, height * width)
            for channel in range(channels):
                found[:, channel] += np.bincount(place, part * colors[lands, channel], height * width)
    landed &= total > 0
    warped = found / np.where(landed, total, 1)[:, None]
    return warped.reshape(height, width, channels), landed.reshape(height, width)


def photometric_importance(source: np.ndarray, target: np.ndarray, flow: np.ndarray) -> np.ndarray:
    """Return Z [h, w]: IMPORTANCE times |source - target sampled by the flow|, mean over RGB."""
    return np.asarray(IMPORTANCE * np.abs(np.asarray(source, np.float64) - sampled(target, flow)).mean(axis=-1))
