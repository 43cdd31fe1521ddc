"""Frechet distance between two sets of vectors, each modeled as a Gaussian; for colors, the palette distance.

    d^2 = |mu_a - mu_b|^2 + tr(S_a + S_b - 2 (S_a^1/2 S_b S_a^1/2)^1/2)

With the features at all positions of an image as vectors, it is SinGAN's SIFID (single image FID), except for the
network.
"""

from dataclasses import dataclass

import numpy as np

from stylerf.errors import InvalidValue

CHUNK = 1 << 20  # vectors to convert to float64 at once


@dataclass(frozen=True, eq=False)
class Moments:
    """Mean [c], and covariance [c, c] divided by n."""

    mean: np.ndarray
    covariance: np.ndarray


def moments(vectors: np.ndarray) -> Moments:
    """Return mean and covariance of vectors [n, c], float64. InvalidValue if there are none or one is not finite."""
    values = np.asarray(vectors)
    if values.ndim != 2 or len(values) == 0 or not np.isfinite(values).all():
        raise InvalidValue(f"expected finite vectors [n, c], got an array of shape {values.shape}")
    mean = values.mean(axis=0, dtype=np.float64)
    products = np.zeros((len(mean), len(mean)))
    for start in range(0, len(values), CHUNK):
        centered = values[start : start + CHUNK] - mean
        products += centered.T @ centered
    return Moments(mean, products / len(values))


def frechet_squared(a: Moments, b: Moments) -> float:
    """Return d^2, clamped to be at least 0."""
    if a.mean.shape != b.mean.shape:
        raise InvalidValue(f"expected vectors of one length, got {a.mean.shape} and {b.mean.shape}")
    root = symmetric_root(a.covariance)
    # The trace of the product's root needs only eigenvalues; rounding may break the product's symmetry and their sign.
    cross = np.linalg.eigvalsh(_symmetric(root @ b.covariance @ root))
    shift = a.mean - b.mean
    squared = shift @ shift + np.trace(a.covariance + b.covariance) - 2 * np.sqrt(np.clip(cross, 0, None)).sum()
    return float(max(squared, 0.0))


def symmetric_root(matrix: np.ndarray) -> np.ndarray:
    """Return the symmetric square root of a positive semi-definite matrix; negative eigenvalues are clamped to 0."""
    values, vectors = np.linalg.eigh(_symmetric(matrix))
    return (vectors * np.sqrt(np.clip(values, 0, None))) @ vectors.T


def _symmetric(matrix: np.ndarray) -> np.ndarray:
    return (matrix + matrix.T) / 2


@dataclass(frozen=True)
class PaletteDistance:
    """Distances in sRGB values 0..1; that of covariances in their square.

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
    return distance_of_moments(color_moments(a), color_moments(b))


def distance_of_moments(first: Moments, second: Moments) -> PaletteDistance:
    """Compare the color_moments() of two images."""
    return PaletteDistance(
        mean=float(np.linalg.norm(first.mean - second.mean)),
        covariance=float(np.linalg.norm(first.covariance - second.covariance)),
        frechet=float(np.sqrt(frechet_squared(first, second))),
    )


def color_moments(colors: np.ndarray) -> Moments:
    """Return the mean and covariance of colors [n, 3]. InvalidValue if there are none or one is not finite."""
    if np.ndim(colors) != 2 or np.shape(colors)[1] != 3:
        raise InvalidValue(f"expected finite colors [n, 3], got an array of shape {np.shape(colors)}")
    return moments(colors)
