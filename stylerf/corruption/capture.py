"""Faults of a capture: poses that are off, views that are missing, a near plane at the wrong place.

Poses are [n, 4, 4] world_from_camera, OpenCV axes, scene units; results are new arrays.
"""

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.geometry.scene_normalization import focus_of


def noisy_poses(poses: np.ndarray, degrees: float, share: float, generator: np.random.Generator) -> np.ndarray:
    """Every camera turned and moved by chance, each by itself.

    Turned about its own center by a rotation vector whose three components are normal with standard deviation
    `degrees`; moved by a vector whose three components are normal with standard deviation `share` times the median
    distance of the cameras from their focus.
    """
    poses = np.asarray(poses, np.float64)
    turns = np.radians(degrees) * generator.standard_normal((len(poses), 3))
    moves = share * median_distance(poses) * generator.standard_normal((len(poses), 3))
    noisy = poses.copy()
    noisy[:, :3, :3] = rotations(turns) @ poses[:, :3, :3]
    noisy[:, :3, 3] += moves
    return noisy


def median_distance(poses: np.ndarray) -> float:
    """Median distance of the cameras from the point that they look at, scene units."""
    return float(np.median(np.linalg.norm(poses[:, :3, 3] - focus_of(poses), axis=1)))


def rotations(vectors: np.ndarray) -> np.ndarray:
    """[n, 3, 3] of rotation vectors [n, 3] (radians) by Rodrigues' formula."""
    angles = np.linalg.norm(vectors, axis=1)
    axes = vectors / np.maximum(angles, 1e-12)[:, None]
    x, y, z = axes.T
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(-1, 3, 3)
    sine, cosine = np.sin(angles)[:, None, None], np.cos(angles)[:, None, None]
    return np.eye(3) + sine * cross + (1 - cosine) * cross @ cross


def spread_views(centers: np.ndarray, count: int, generator: np.random.Generator) -> list[int]:
    """Indices of `count` of the camera centers [n, 3], spread out, in rising order.

    Begins with one by chance; each next one is the farthest from those chosen (Gonzalez 1985: the least distance
    between two of them is at least half the best possible).
    """
    if not 0 < count <= len(centers):
        raise InvalidValue(f"{count} of {len(centers)} views cannot be chosen")
    chosen = [int(generator.integers(len(centers)))]
    least = np.linalg.norm(centers - centers[chosen[0]], axis=1)
    while len(chosen) < count:
        chosen.append(int(np.argmax(least)))
        least = np.minimum(least, np.linalg.norm(centers - centers[chosen[-1]], axis=1))
    return sorted(chosen)


def one_sided(poses: np.ndarray, share: float, generator: np.random.Generator) -> list[int]:
    """Indices of the `share` of the cameras (three at least) that stand on one side: what the others see is hidden.

    By their places along the direction, of 64 drawn at random, in which they lie widest apart.
    """
    directions = generator.standard_normal((64, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    places = poses[:, :3, 3] @ directions.T  # [n, 64]
    along = places[:, int(np.argmax(np.ptp(places, axis=0)))]
    count = min(len(poses), max(3, round(share * len(poses))))
    return sorted(np.argsort(-along, kind="stable")[:count].tolist())


def cut_box(aabb: tuple, share: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """A box (lower, upper corner) that lacks the `share` of itself at the upper end of its third axis."""
    low, high = ([float(value) for value in corner] for corner in aabb)
    high[2] -= share * (high[2] - low[2])
    return tuple(low), tuple(high)


def late_near(near: float, far: float, share: float, distance: float) -> float:
    """A near plane that cuts what lies before `share` of `distance`, never nearer than it was nor beyond far."""
    return min(max(near, share * distance), 0.9 * far)
