"""Which rays of a view carry gradient in one stylisation step.

The style loss needs the whole picture, the field need not learn from every ray of it. `full` and `deferred` learn from
all (deferred: rendered once without a graph, then again in chunks with the cached dL/d(picture); ARF); `dilated` from
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
    blur: side of a box filter applied first (0: none). With a blur as wide as the dilation's gaps the selected rays
    speak for their neighbours too, instead of dropping what these were asked for.
    """
    height, width = gradient.shape[:2]
    if blur > 1 and len(pixels) < height * width:
        gradient = uniform_filter(gradient, size=(blur, blur, 1), mode="nearest")
    return np.ascontiguousarray(
        gradient.reshape(-1, 3)[pixels] * np.float32(height * width / len(pixels)), dtype=np.float32
    )
