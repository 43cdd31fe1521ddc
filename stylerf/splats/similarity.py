"""3D Gaussians in other coordinates."""

import numpy as np
from scipy.spatial.transform import Rotation

from stylerf.geometry.spherical_harmonics import harmonics
from stylerf.kernels.cpu.splats import Gaussians

DIRECTIONS = 64  # of the sphere, that a turn of the harmonics is solved from; 9 would do


def moved_gaussians(gaussians: Gaussians, similarity: np.ndarray) -> Gaussians:
    """Return the Gaussians after a similarity [4, 4], scale * rotation | translation; colors turn along."""
    scale = float(np.cbrt(np.linalg.det(similarity[:3, :3])))
    turn = similarity[:3, :3] / scale
    centers = gaussians.centers.astype(np.float64) @ similarity[:3, :3].T + similarity[:3, 3]
    rotations = Rotation.from_matrix(turn) * Rotation.from_quat(gaussians.quaternions, scalar_first=True)
    bands = gaussians.harmonics.shape[1]
    turned = np.einsum("ab,nbc->nac", turned_bands(turn, bands), gaussians.harmonics.astype(np.float64))
    return Gaussians(
        centers.astype(np.float32),
        (gaussians.log_scales + np.float32(np.log(scale))).astype(np.float32),
        rotations.as_quat(canonical=True, scalar_first=True).astype(np.float32),
        gaussians.logits,
        turned.astype(np.float32),
    )


def turned_bands(turn: np.ndarray, bands: int) -> np.ndarray:
    """Return the matrix [bands, bands] of coefficients after a rotation [3, 3]: Y(d) M c = Y(turn^T d) c for all d."""
    degree = round(bands**0.5) - 1
    directions = np.random.default_rng(0).normal(size=(DIRECTIONS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    after = harmonics(directions, degree).astype(np.float64)
    before = harmonics(directions @ turn, degree).astype(np.float64)
    matrix: np.ndarray = np.linalg.lstsq(after, before, rcond=None)[0]
    return matrix
