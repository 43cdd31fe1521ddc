"""Which rays of a view carry gradient in one stylization step.

The style loss needs the whole picture, the field need not learn from every ray of it. `full` and `deferred` learn from
all (deferred: rendered once without a graph, then again in threads with the cached dL/d(picture); ARF); `dilated` from
every Nc-th ray in both axes from a random offset, `random` from as many random rays, `patch` from one window of as many
(DeSRF section 3.3; patch: Chiang et al. 2022).
"""

import numpy as np
from scipy.ndimage import uniform_filter

from stylerf.errors import InvalidValue

STRATEGIES = ("full", "deferred", "dilated", "random", "patch")


def selected_pixels(
    strategy: str, height: int, width: int, dilation: int, generator: np.random.Generator
) -> np.ndarray:
    """Row-major indices, ascending for all but `random`, int64, of the pixels that learn."""
    if strategy not in STRATEGIES:
        raise InvalidValue(f"ray strategy {strategy!r} is none of {', '.join(STRATEGIES)}")
    if strategy in ("full", "deferred") or dilation == 1:
        return np.arange(height * width)
    if strategy == "random":
        return generator.choice(height * width, max(1, height * width // dilation**2), replace=False)
    if strategy == "dilated":
        # An offset is as likely as it has rows: sides that dilation does not divide stay unbiased.
        rows = np.arange(int(generator.integers(height)) % dilation, height, dilation)
        columns = np.arange(int(generator.integers(width)) % dilation, width, dilation)
    else:
        tall, wide = max(1, height // dilation), max(1, width // dilation)
        top = int(generator.integers(height - tall + 1))
        left = int(generator.integers(width - wide + 1))
        rows, columns = np.arange(top, top + tall), np.arange(left, left + wide)
    return (rows[:, None] * width + columns[None, :]).ravel()


def selected_gradient(gradient: np.ndarray, pixels: np.ndarray, blur: int) -> np.ndarray:
    """dL/d(picture) [h, w, 3] at the selected pixels [n, 3], scaled by all/selected: the full gradient in expectation.

    Not pixel by pixel for `patch`: its windows hold the middle of the picture more often than its sides.
    blur: side of a box filter applied first, odd (0: none): selected rays then speak for their neighbors too
    (DeSRF: 3), instead of dropping what these were asked for, at the price of the finest strokes.
    """
    height, width = gradient.shape[:2]
    if blur > 1 and len(pixels) < height * width:
        gradient = uniform_filter(gradient, size=(blur, blur, 1), mode="nearest")
    return np.ascontiguousarray(
        gradient.reshape(-1, 3)[pixels] * np.float32(height * width / len(pixels)), dtype=np.float32
    )


def spread_over_picture(changes: np.ndarray, pixels: np.ndarray, height: int, width: int, dilation: int) -> np.ndarray:
    """Changes [n, k] of a dilated selection's pixels, linear in between: what all pixels [h * w, k] changed by, about.

    Rays that were not walked anew stay true to what the field has learned since, all but its finest detail.
    """
    top, left = divmod(int(pixels[0]), width)
    rows, columns = -(-(height - top) // dilation), -(-(width - left) // dilation)
    lattice = changes.reshape(rows, columns, -1)
    return _stretched(_stretched(lattice, top, height, dilation, 0), left, width, dilation, 1).reshape(
        height * width, -1
    )


def _stretched(lattice: np.ndarray, offset: int, length: int, dilation: int, axis: int) -> np.ndarray:
    """The lattice along one axis at every pixel, linear between its places, level outside them."""
    at = np.clip((np.arange(length) - offset) / dilation, 0, lattice.shape[axis] - 1)
    below = np.minimum(at.astype(np.int64), max(0, lattice.shape[axis] - 2))
    share = (at - below).astype(np.float32).reshape([-1 if a == axis else 1 for a in range(3)])
    above = np.minimum(below + 1, lattice.shape[axis] - 1)
    return lattice.take(below, axis) * (1 - share) + lattice.take(above, axis) * share
