"""Ray selection: which rays of a view receive gradients in a stylization step.

The style loss needs the whole image, but the field need not learn from all of its rays:

    full      all rays
    deferred  all rays, rendered once without a graph and again in parts with the cached dL/d(image) (ARF)
    dilated   every Nc-th ray along both axes, from a random offset (DeSRF, section 3.3)
    random    the same number of random rays
    patch     one window with the same number of rays (Chiang et al. 2022)
"""

import numpy as np
from scipy.ndimage import uniform_filter

from stylerf.errors import InvalidValue

STRATEGIES = ("full", "deferred", "dilated", "random", "patch")


def selected_pixels(
    strategy: str, height: int, width: int, dilation: int, generator: np.random.Generator
) -> np.ndarray:
    """Return the row-major indices [n] int64 of the selected pixels, ascending except for `random`.

    Raises:
        InvalidValue: the strategy is unknown.
    """
    if strategy not in STRATEGIES:
        raise InvalidValue(f"unknown ray strategy {strategy!r}; expected one of {', '.join(STRATEGIES)}")
    if strategy in ("full", "deferred") or dilation == 1:
        return np.arange(height * width)
    if strategy == "random":
        return generator.choice(height * width, max(1, height * width // dilation**2), replace=False)
    if strategy == "dilated":
        # Offsets are drawn in proportion to their number of rows, so that no row is favored if dilation does not divide
        # the size.
        rows = np.arange(int(generator.integers(height)) % dilation, height, dilation)
        columns = np.arange(int(generator.integers(width)) % dilation, width, dilation)
    else:
        tall, wide = max(1, height // dilation), max(1, width // dilation)
        top = int(generator.integers(height - tall + 1))
        left = int(generator.integers(width - wide + 1))
        rows, columns = np.arange(top, top + tall), np.arange(left, left + wide)
    return (rows[:, None] * width + columns[None, :]).ravel()


def selected_gradient(gradient: np.ndarray, pixels: np.ndarray, blur: int) -> np.ndarray:
    """Return the gradient of the selected pixels [n, 3], scaled to be the full gradient in expectation.

    `patch` is biased per pixel: its windows cover the center of the image more often than its borders.

    Args:
        gradient: dL/d(image), [h, w, 3].
        pixels: [n], selected.
        blur: odd side length of a box filter applied first, 0 for none. Selected rays then also carry their neighbors'
            gradients (DeSRF: 3), at the cost of the finest strokes.
    """
    height, width = gradient.shape[:2]
    if blur > 1 and len(pixels) < height * width:
        gradient = uniform_filter(gradient, size=(blur, blur, 1), mode="nearest")
    return np.ascontiguousarray(
        gradient.reshape(-1, 3)[pixels] * np.float32(height * width / len(pixels)), dtype=np.float32
    )


def spread_over_picture(changes: np.ndarray, pixels: np.ndarray, height: int, width: int, dilation: int) -> np.ndarray:
    """Interpolate the changes [n, k] of a dilated selection's pixels to all pixels, [h * w, k].

    Pixels that were not rendered again then follow what the field has learned since, except for the finest detail.
    """
    top, left = divmod(int(pixels[0]), width)
    rows, columns = -(-(height - top) // dilation), -(-(width - left) // dilation)
    lattice = changes.reshape(rows, columns, -1)
    return _stretched(_stretched(lattice, top, height, dilation, 0), left, width, dilation, 1).reshape(
        height * width, -1
    )


def _stretched(lattice: np.ndarray, offset: int, length: int, dilation: int, axis: int) -> np.ndarray:
    """Interpolate a lattice linearly along one axis to every pixel, clamped at the ends."""
    at = np.clip((np.arange(length) - offset) / dilation, 0, lattice.shape[axis] - 1)
    # max: a single-row lattice has no second row to interpolate to.
    below = np.minimum(at.astype(np.int64), max(0, lattice.shape[axis] - 2))
    fraction = (at - below).astype(np.float32).reshape([-1 if a == axis else 1 for a in range(3)])
    above = np.minimum(below + 1, lattice.shape[axis] - 1)
    return lattice.take(below, axis) * (1 - fraction) + lattice.take(above, axis) * fraction
