"""Convert camera poses to our convention: world_from_camera with OpenCV axes (x right, y down, z forward)."""

import numpy as np

from stylerf.errors import InvalidValue

# Largest entry of |R R^T - I| attributed to rounding: files with five digits reach 1e-4, real errors 1e-2 and more.
ROTATION_TOLERANCE = 2e-3

_OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
_OPENCV_FROM_MITSUBA = np.diag([-1.0, -1.0, 1.0, 1.0])


def from_opengl(world_from_camera: np.ndarray) -> np.ndarray:
    """Convert poses of Blender, instant-ngp or nerfstudio: camera-to-world [.., 4, 4], x right, y up, z backward."""
    return world_from_camera @ _OPENCV_FROM_OPENGL


def from_mitsuba(world_from_camera: np.ndarray) -> np.ndarray:
    """Convert poses of Mitsuba: camera-to-world [.., 4, 4], x left, y up, z forward."""
    return world_from_camera @ _OPENCV_FROM_MITSUBA


def from_llff(pose: np.ndarray) -> np.ndarray:
    """Convert an LLFF pose, [3, 4+] with columns down, right, backward, center, to [4, 4]."""
    down, right, backward, center = pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3]
    return with_last_row(np.stack([right, down, -backward, center], axis=1))


def from_colmap(camera_from_world: np.ndarray) -> np.ndarray:
    """Convert a COLMAP pose, world-to-camera [3, 4] with OpenCV axes, to [4, 4]."""
    rotation, translation = camera_from_world[:3, :3], camera_from_world[:3, 3]
    return with_last_row(np.concatenate([rotation.T, (-rotation.T @ translation)[:, None]], axis=1))


def with_last_row(pose: np.ndarray) -> np.ndarray:
    """Extend a pose [3 or 4, 4] to [4, 4] with the last row 0 0 0 1."""
    whole = np.eye(4)
    whole[:3] = pose[:3]
    return whole


def checked_pose(pose: np.ndarray) -> np.ndarray:
    """Replace the rotation of a pose [4, 4] with the nearest exact one (polar decomposition).

    Raises:
        InvalidValue: The pose is not finite, or it is scaled, sheared or mirrored beyond ROTATION_TOLERANCE.
    """
    pose = np.asarray(pose, dtype=np.float64)
    if pose.shape != (4, 4):
        raise InvalidValue(f"its pose has shape {pose.shape}, expected 4x4")
    if not np.isfinite(pose).all():
        raise InvalidValue("its pose holds NaN or infinity")
    rotation = pose[:3, :3]
    fault = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if fault > ROTATION_TOLERANCE or np.linalg.det(rotation) < 0:
        found = "mirrored" if fault <= ROTATION_TOLERANCE else f"R R^T differs from the identity by {fault:.2g}"
        raise InvalidValue(f"the upper left 3x3 of its pose is not a rotation ({found})")
    left, _, right = np.linalg.svd(rotation)
    exact = np.eye(4)
    exact[:3, :3], exact[:3, 3] = left @ right, pose[:3, 3]
    return exact
