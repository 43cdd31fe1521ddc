"""Frechet distance between two sets of vectors, each taken as the Gaussian of its mean and covariance.

    d^2 = |mu_a - mu_b|^2 + tr(S_a + S_b - 2 (S_a^1/2 S_b S_a^1/2)^1/2)

With vectors the features at the positions of one image it is SinGAN's SIFID (single image FID) in all but the network.
"""

from dataclasses import dataclass

import numpy as np

from stylerf.errors import InvalidValue


@dataclass(frozen=True, eq=False)
class Moments:
    """mean [c]; covariance [c, c] by 1/n."""

    mean: np.ndarray
    covariance: np.ndarray


def moments(vectors: np.ndarray) -> Moments:
    """Mean and covariance of vectors [n, c], float64; InvalidValue where there is none or one is not finite."""
    values = np.asarray(vectors, np.float64)
    if values.ndim != 2 or len(values) == 0 or not np.isfinite(values).all():
        raise InvalidValue(f"expected finite vectors [n, c], got an array of shape {values.shape}")
    mean = values.mean(axis=0)
    centerd = values - mean
    return Moments(mean, centerd.T @ centerd / len(values))


def frechet_squared(a: Moments, b: Moments) -> float:
    """d^2 >= 0 (rounding below zero is taken as zero)."""
    if a.mean.shape != b.mean.shape:
        raise InvalidValue(f"vectors of one length were expected, got {a.mean.shape} and {b.mean.shape}")
    root = symmetric_root(a.covariance)
    cross = np.linalg.eigvalsh(_symmetric(root @ b.covariance @ root))
    shift = a.mean - b.mean
    squared = shift @ shift + np.trace(a.covariance + b.covariance) - 2 * np.sqrt(np.clip(cross, 0, None)).sum()
    return float(max(squared, 0.0))


def symmetric_root(matrix: np.ndarray) -> np.ndarray:
    """Symmetric square root of a positive semi-definite matrix; rounding below zero is taken as zero."""
    values, vectors = np.linalg.eigh(_symmetric(matrix))
    return (vectors * np.sqrt(np.clip(values, 0, None))) @ vectors.T


def _symmetric(matrix: np.ndarray) -> np.ndarray:
    return (matrix + matrix.T) / 2
