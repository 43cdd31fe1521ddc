"""How colorful an image is."""

import numpy as np

from stylerf.errors import InvalidValue


def colorfulness(colors: np.ndarray) -> float:
    """Return how colorful sRGB colors [n, 3] in 0..1 are: 0 for grays (Hasler and Suesstrunk 2003, M^(3), in 0..1).

    Raises:
        InvalidValue: There are no colors, or one is not finite.
    """
    if colors.ndim != 2 or colors.shape[1] != 3 or len(colors) == 0 or not np.isfinite(colors).all():
        raise InvalidValue(f"expected finite colors [n, 3], got an array of shape {colors.shape}")
    red, green, blue = np.asarray(colors, np.float64).T
    axes = np.stack([red - green, (red + green) / 2 - blue])
    return float(np.hypot(*axes.std(axis=1)) + 0.3 * np.hypot(*axes.mean(axis=1)))
