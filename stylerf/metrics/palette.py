"""Distance between the colours of two sets of pixels, whatever their places."""

from dataclasses import dataclass

import numpy as np

from stylerf.errors import InvalidValue


@dataclass(frozen=True)
class PaletteDistance:
    """mean: |mu_a - mu_b|. covariance: Frobenius norm of S_a - S_b. frechet: 2-Wasserstein distance of the Gaussians.

    All in units of sRGB-encoded 0..1 values (the covariance in their square).
    """

    mean: float
    covariance: float
    frechet: float


def palette_distance(a: np.ndarray, b: np.ndarray) -> PaletteDistance:
    """Compare colours [n, 3] and [m, 3] by their first two moments.

    frechet^2 = |mu_a - mu_b|^2 + tr(S_a + S_b - 2 (S_a^1/2 S_b S_a^1/2)^1/2), covariances by 1/n.
    """
    mean_a, covariance_a = _moments(a)
    mean_b, covariance_b = _moments(b)
    root_a = _root(covariance_a)
    cross = _root(root_a @ covariance_b @ root_a)
    shift = mean_a - mean_b
    squared = shift @ shift + np.trace(covariance_a + covariance_b - 2 * cross)
    return PaletteDistance(
        mean=float(np.linalg.norm(shift)),
        covariance=float(np.linalg.norm(covariance_a - covariance_b)),
        frechet=float(np.sqrt(max(squared, 0.0))),
    )


def _moments(colours: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    colours = np.asarray(colours, np.float64)
    if colours.ndim != 2 or colours.shape[1] != 3 or len(colours) == 0 or not np.isfinite(colours).all():
        raise InvalidValue(f"expected finite colours [n, 3], got an array of shape {colours.shape}")
    mean = colours.mean(axis=0)
    centred = colours - mean
    return mean, centred.T @ centred / len(colours)


def _root(matrix: np.ndarray) -> np.ndarray:
    """Symmetric square root of a positive semi-definite matrix; rounding below zero is taken as zero."""
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    return (vectors * np.sqrt(np.clip(values, 0, None))) @ vectors.T
