"""How far two pictures of one thing lie apart as a whole, whatever their sharpness and exposure."""

import numpy as np
from scipy.ndimage import gaussian_filter

FINEST, COARSEST = 1.0, 8.0  # standard deviations, pixels, of what is blurred away and of what counts as background
LARGEST_SHARE = 1 / 3  # of the shorter side: shifts beyond are not looked for


def shift_between(one: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, float]:
    """Shift (right, down), pixels, from `one` to `other`, [h, w] each, and how alike they are then, -1..1.

    The peak of the cross-correlation of both pictures between two blurs, to a part of a pixel by a parabola. Blur is
    even to all sides: it flattens the peak and does not move it. (0, 0) and 0 where a picture is of one color.
    """
    height, width = one.shape
    # Less towards the borders, where one picture shows what the other does not.
    window = np.sqrt(np.outer(np.hanning(height + 2), np.hanning(width + 2)))[1:-1, 1:-1]
    one, other = (_detail(picture, window) for picture in (one, other))
    most = max(1, int(min(height, width) * LARGEST_SHARE))
    # Room for shifts to all sides: what leaves at one border does not return at another.
    size = 2 * height + 4, 2 * width + 4
    energy = float(np.sqrt(np.square(one).sum() * np.square(other).sum()))
    if energy <= 1e-9:
        return np.zeros(2), 0.0
    products = np.fft.irfft2(np.fft.rfft2(one, size).conj() * np.fft.rfft2(other, size), size)
    near = np.roll(products, (most + 1, most + 1), axis=(0, 1))[: 2 * most + 3, : 2 * most + 3]
    row, column = np.unravel_index(near[1:-1, 1:-1].argmax(), (2 * most + 1, 2 * most + 1))
    down = row - most + _vertex(near[row : row + 3, column + 1])
    right = column - most + _vertex(near[row + 1, column : column + 3])
    return np.array([right, down]), float(near[row + 1, column + 1]) / energy


def _detail(picture: np.ndarray, window: np.ndarray) -> np.ndarray:
    """What is neither noise nor background, faded out towards the borders, of mean 0."""
    picture = np.asarray(picture, np.float64)
    detail = gaussian_filter(picture, FINEST) - gaussian_filter(picture, COARSEST)
    return (detail - (detail * window).sum() / window.sum()) * window


def _vertex(values: np.ndarray) -> float:
    """Where the parabola through three values has its vertex, -1/2..1/2 about the middle one, which is the largest."""
    before, middle, after = values
    bend = before - 2 * middle + after
    return float(np.clip(0.5 * (before - after) / bend, -0.5, 0.5)) if bend < 0 else 0.0
