"""Epipolar constraint and parallax of matched points in two views.

Points are undistorted (x, y) = (X/Z, Y/Z). Poses are world_from_camera, OpenCV axes.
"""

import numpy as np


def essential(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the essential matrix E [3, 3] of two poses [4, 4]: x2^T E x1 = 0; the translation has length 1.

    All zero for cameras at the same position, where every pair of points is consistent.
    """
    second_from_first = np.linalg.inv(second) @ first
    rotation, shift = second_from_first[:3, :3], second_from_first[:3, 3]
    x, y, z = shift / max(np.linalg.norm(shift), 1e-300)
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ rotation


def epipolar_distance(matrix: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the distance of matched points [n, 2] from each other's epipolar lines, the larger of both views, [n].

    Multiply by the focal length for pixels. 0 if the essential matrix is zero.
    """
    one = np.concatenate([first, np.ones((len(first), 1))], axis=1)
    two = np.concatenate([second, np.ones((len(second), 1))], axis=1)
    in_second, in_first = one @ matrix.T, two @ matrix
    residual = np.abs((two * in_second).sum(axis=1))
    lengths = np.minimum(np.linalg.norm(in_second[:, :2], axis=1), np.linalg.norm(in_first[:, :2], axis=1))
    return np.where(residual > 0, residual / np.maximum(lengths, 1e-12), 0.0)


def largest_parallax(point: np.ndarray, centers: np.ndarray) -> float:
    """Return the largest angle, in degrees, between two rays from camera centers [n, 3] to a point [3]."""
    rays = point - centers
    rays = rays / np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-300)
    return float(np.degrees(np.arccos(np.clip((rays @ rays.T).min(), -1, 1))))
