"""Frechet distance between two sets of vectors, each modeled as a Gaussian.

    d^2 = |mu_a - mu_b|^2 + tr(S_a + S_b - 2 (S_a^1/2 S_b S_a^1/2)^1/2)

With the features at all positions of an image as vectors, it is SinGAN's SIFID (single image FID) but for the network.
"""

from dataclasses import dataclass

import numpy as np

from stylerf.errors import InvalidValue


@dataclass(frozen=True, eq=False)
class Moments:
    """Mean [c], and covariance [c, c] divided by n."""

    mean: np.ndarray
    covariance: np.ndarray


def moments(vectors: np.ndarray) -> Moments:
    """Return mean and covariance of vectors [n, c] in float64; InvalidValue if there are none or one is not finite."""
    values = np.asarray(vectors, np.float64)
    if values.ndim != 2 or len(values) == 0 or not np.isfinite(values).all():
        raise InvalidValue(f"expected finite vectors [n, c], got an array of shape {values.shape}")
    mean = values.mean(axis=0)
    centered = values - mean
    return Moments(mean, centered.T @ centered / len(values))


def frechet_squared(a: Moments, b: Moments) -> float:
    """Return d^2, clamped to be at least 0."""
    if a.mean.shape != b.mean.shape:
        raise InvalidValue(f"expected vectors of one length, got {a.mean.shape} and {b.mean.shape}")
    root = symmetric_root(a.covariance)
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
