"""Transform 3D Gaussians to other coordinates."""

import numpy as np
from scipy.spatial.transform import Rotation

from stylerf.geometry.spherical_harmonics import harmonics
from stylerf.kernels.cpu.splats import Gaussians

DIRECTIONS = 64  # on the sphere, to solve for the rotation of harmonics; 9 would suffice


def moved_gaussians(gaussians: Gaussians, similarity: np.ndarray) -> Gaussians:
    """Return the Gaussians after a similarity [4, 4], scale * rotation | translation, including their colors."""
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
    """Return the matrix M [bands, bands] that rotates coefficients by `turn` [3, 3]: Y(d) M c = Y(turn^T d) c."""
    degree = round(bands**0.5) - 1
    directions = np.random.default_rng(0).normal(size=(DIRECTIONS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    after = harmonics(directions, degree).astype(np.float64)
    before = harmonics(directions @ turn, degree).astype(np.float64)
    matrix: np.ndarray = np.linalg.lstsq(after, before, rcond=None)[0]
    return matrix
