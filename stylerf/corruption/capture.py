"""Faults of a capture: wrong poses, missing views, a near plane that is too far.

Poses are [n, 4, 4] world_from_camera, OpenCV axes, scene units. Arguments are not modified.
"""

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.geometry.scene_normalization import focus_of

Point = tuple[float, float, float]


def noisy_poses(poses: np.ndarray, degrees: float, share: float, generator: np.random.Generator) -> np.ndarray:
    """Rotate and translate every camera randomly and independently.

    Args:
        poses: [n, 4, 4].
        degrees: Standard deviation of each component of the rotation vector, about the camera's center.
        share: Standard deviation of each component of the translation, as a fraction of the cameras' median distance
            from their focus.
    """
    poses = np.asarray(poses, np.float64)
    turns = np.radians(degrees) * generator.standard_normal((len(poses), 3))
    moves = share * median_distance(poses) * generator.standard_normal((len(poses), 3))
    noisy = poses.copy()
    noisy[:, :3, :3] = rotations(turns) @ poses[:, :3, :3]
    noisy[:, :3, 3] += moves
    return noisy


def median_distance(poses: np.ndarray) -> float:
    """Return the median distance of the cameras from the point that they look at, scene units."""
    return float(np.median(np.linalg.norm(poses[:, :3, 3] - focus_of(poses), axis=1)))


def rotations(vectors: np.ndarray) -> np.ndarray:
    """Convert rotation vectors [n, 3] (radians) to matrices [n, 3, 3] by Rodrigues' formula."""
    angles = np.linalg.norm(vectors, axis=1)
    axes = vectors / np.maximum(angles, 1e-12)[:, None]
    x, y, z = axes.T
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(-1, 3, 3)
    sine, cosine = np.sin(angles)[:, None, None], np.cos(angles)[:, None, None]
    return np.eye(3) + sine * cross + (1 - cosine) * cross @ cross


def spread_views(centers: np.ndarray, count: int, generator: np.random.Generator) -> list[int]:
    """Choose `count` well-spread camera centers of [n, 3]; return their indices, ascending.

    Farthest-point sampling from a random start (Gonzalez 1985: the smallest distance between two chosen centers is at
    least half the optimum).
    """
    if not 0 < count <= len(centers):
        raise InvalidValue(f"cannot choose {count} of {len(centers)} views")
    chosen = [int(generator.integers(len(centers)))]
    nearest = np.linalg.norm(centers - centers[chosen[0]], axis=1)
    while len(chosen) < count:
        chosen.append(int(np.argmax(nearest)))
        nearest = np.minimum(nearest, np.linalg.norm(centers - centers[chosen[-1]], axis=1))
    return sorted(chosen)


def one_sided(poses: np.ndarray, share: float, generator: np.random.Generator) -> list[int]:
    """Choose the fraction `share` of the cameras, at least three, on one side of the scene; return their indices.

    The side is in the direction, out of 64 random ones, along which the cameras spread most.
    """
    directions = generator.standard_normal((64, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    places = poses[:, :3, 3] @ directions.T  # [n, 64]
    along = places[:, int(np.argmax(np.ptp(places, axis=0)))]
    count = min(len(poses), max(3, round(share * len(poses))))
    return sorted(np.argsort(-along, kind="stable")[:count].tolist())


def cut_box(aabb: tuple[Point, Point], share: float) -> tuple[Point, Point]:
    """Return a box (lower, upper corner) with the fraction `share` cut off at the upper end of its third axis."""
    low, (x, y, z) = aabb
    return low, (x, y, z - share * (z - low[2]))


def late_near(near: float, far: float, share: float, distance: float) -> float:
    """Return the near plane moved to `share` of `distance`, but neither closer than before nor beyond 0.9 far."""
    return min(max(near, share * distance), 0.9 * far)
