"""Distance between the color distributions of two sets of pixels."""

from dataclasses import dataclass

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.metrics.frechet import Moments, frechet_squared, moments


@dataclass(frozen=True)
class PaletteDistance:
    """Distances in sRGB values 0..1; the covariance in their square.

    Attributes:
        mean: |mu_a - mu_b|.
        covariance: Frobenius norm of S_a - S_b.
        frechet: 2-Wasserstein distance of the Gaussians.
    """

    mean: float
    covariance: float
    frechet: float


def palette_distance(a: np.ndarray, b: np.ndarray) -> PaletteDistance:
    """Compare colors [n, 3] and [m, 3] by mean and covariance (divided by n)."""
    first, second = _moments(a), _moments(b)
    return PaletteDistance(
        mean=float(np.linalg.norm(first.mean - second.mean)),
        covariance=float(np.linalg.norm(first.covariance - second.covariance)),
        frechet=float(np.sqrt(frechet_squared(first, second))),
    )


def _moments(colors: np.ndarray) -> Moments:
    if np.ndim(colors) != 2 or np.shape(colors)[1] != 3:
        raise InvalidValue(f"expected finite colors [n, 3], got an array of shape {np.shape(colors)}")
    return moments(colors)
