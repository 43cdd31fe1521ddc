"""The global shift between two images, insensitive to sharpness and exposure."""

import numpy as np
from scipy.ndimage import gaussian_filter

FINEST, COARSEST = 1.0, 8.0  # band-pass: standard deviations of the two Gaussians, pixels
LARGEST_SHARE = 1 / 3  # largest shift, as a fraction of the shorter side


def shift_between(one: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, float]:
    """Estimate the shift from `one` to `other`, [h, w] each.

    The peak of the cross-correlation of the band-passed images, refined to subpixels by a parabola. Symmetric blur
    flattens the peak but does not move it.

    Returns:
        The shift (right, down), pixels, and the correlation at the peak, -1..1; zeros if an image is uniform.
    """
    height, width = one.shape
    # Fades towards the borders, where the images show different things.
    window = np.sqrt(np.outer(np.hanning(height + 2), np.hanning(width + 2)))[1:-1, 1:-1]
    one, other = (_detail(picture, window) for picture in (one, other))
    most = max(1, int(min(height, width) * LARGEST_SHARE))
    # Zero padding, so that the circular correlation does not wrap around.
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
    """Band-pass an image and apply the window, with mean 0."""
    picture = np.asarray(picture, np.float64)
    detail = gaussian_filter(picture, FINEST) - gaussian_filter(picture, COARSEST)
    return (detail - (detail * window).sum() / window.sum()) * window


def _vertex(values: np.ndarray) -> float:
    """Return the vertex of the parabola through three values, the middle one the largest; -1/2..1/2 from the middle."""
    before, middle, after = values
    bend = before - 2 * middle + after
    return float(np.clip(0.5 * (before - after) / bend, -0.5, 0.5)) if bend < 0 else 0.0
