"""Camera paths. Frame i of n depends only on the scene's cameras, i and n, so a job can be rendered in parts."""

from dataclasses import replace

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.geometry.cameras import Camera

PATHS = ("orbit", "spiral", "interpolate")
PARALLEL = 10.0  # mean angle, degrees, between viewing axes and their mean above which cameras look at one point


def path_camera(kind: str, cameras: list[Camera], index: int, count: int, focus_depth: float) -> Camera:
    """Return camera `index` of `count` on a path near the scene's cameras.

    Args:
        kind: One of PATHS.
        cameras: The scene's cameras.
        index: Frame, 0 to count - 1.
        count: Number of frames.
        focus_depth: Distance from the average camera to the point that orbits and spirals look at, scene units, if
            the cameras look in one direction rather than at one point.
    """
    if not cameras:
        raise InvalidValue("a camera path needs the scene's cameras; there are none")
    # Orbit and spiral are closed: frame `count` would be frame 0 again; interpolate ends at its last camera.
    if kind == "orbit":
        pose = _orbit_pose(cameras, index / count, focus_depth)
    elif kind == "spiral":
        pose = _spiral_pose(cameras, index / count, focus_depth)
    elif kind == "interpolate":
        pose = _between_pose(cameras, index / max(count - 1, 1))
    else:
        raise InvalidValue(f"unknown camera path {kind!r}; expected one of {', '.join(PATHS)}")
    return replace(cameras[0], name=f"{index:04d}", world_from_camera=pose)


def look_at(center: np.ndarray, target: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Return the pose [4, 4] (x right, y down, z forward) at `center` that looks at `target` with `up` upwards."""
    forward = _unit(target - center)
    right = _unit(np.cross(forward, up))
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = right, np.cross(forward, right), forward, center
    return pose


def focus_point(cameras: list[Camera]) -> np.ndarray:
    """Return the least-squares intersection of all viewing axes, [3]; for parallel axes, near the cameras' mean."""
    centers = np.array([c.center for c in cameras])
    axes = np.array([c.forward for c in cameras])
    projectors = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    # Parallel axes make the sum singular; regularize towards the mean camera position.
    matrix = projectors.sum(0) + 1e-6 * len(cameras) * np.eye(3)
    right = (projectors @ centers[:, :, None]).sum(0)[:, 0] + 1e-6 * len(cameras) * centers.mean(0)
    return np.linalg.solve(matrix, right)


def average_up(cameras: list[Camera]) -> np.ndarray:
    """Return the mean up direction of the images, a unit vector [3]."""
    return _unit(-np.array([c.world_from_camera[:3, 1] for c in cameras]).mean(0))


def looked_at(cameras: list[Camera], focus_depth: float) -> np.ndarray:
    """Return the point [3] that the cameras look at; if they look in one direction, at focus_depth from their mean."""
    centers = np.array([c.center for c in cameras])
    axes = np.array([c.forward for c in cameras])
    focus, mean = focus_point(cameras), axes.mean(0)
    length = np.linalg.norm(mean)
    apart = np.degrees(np.arccos(np.clip(axes @ mean / max(length, 1e-12), -1, 1))).mean()
    ahead = ((focus - centers) * axes).sum(1) > 0
    # Diverging axes intersect behind the cameras; if cameras surround the focus, the mean axis is meaningless.
    if apart > PARALLEL and (ahead.mean() > 0.5 or length < 0.5):
        return focus
    return centers.mean(0) + _unit(mean) * focus_depth


def _orbit_pose(cameras: list[Camera], share: float, focus_depth: float) -> np.ndarray:
    """Return a pose on an orbit around the focus, at the cameras' median height and distance.

    A full circle if the cameras surround the focus, else back and forth along their arc.
    """
    focus, up = looked_at(cameras, focus_depth), average_up(cameras)
    offsets = np.array([c.center for c in cameras]) - focus
    heights = offsets @ up
    flat = offsets - heights[:, None] * up
    distances = np.linalg.norm(flat, axis=1)
    if np.linalg.norm(flat.mean(0)) > 0.2 * distances.mean():
        first = _unit(flat.mean(0))
    else:
        # The first camera that is not above or below the focus, where its direction would be meaningless.
        first = _unit(flat[int(np.argmax(distances >= 0.1 * distances.mean()))])
    second = np.cross(up, first)
    angles = np.arctan2(flat @ second, flat @ first)
    ordered = np.sort(angles)
    gaps = np.diff(np.append(ordered, ordered[0] + 2 * np.pi))
    if gaps.max() < np.pi / 2:
        angle = 2 * np.pi * share
    else:
        start = ordered[(int(gaps.argmax()) + 1) % len(ordered)]
        width = 2 * np.pi - gaps.max()
        # From 5 % to 95 % of the arc and back, slow at both ends.
        angle = start + width * (0.5 - 0.45 * np.cos(2 * np.pi * share))
    away, height = float(np.median(np.linalg.norm(offsets, axis=1))), float(np.median(heights))
    radius = float(np.sqrt(max(away**2 - height**2, 0)))
    center = focus + radius * (np.cos(angle) * first + np.sin(angle) * second) + height * up
    return look_at(center, focus, up)


def _spiral_pose(cameras: list[Camera], share: float, focus_depth: float) -> np.ndarray:
    """Return a pose on a spiral (LLFF): two turns of an ellipse as wide as 80 % of the cameras, facing one point."""
    poses = np.array([c.world_from_camera for c in cameras])
    center, up, target = poses[:, :3, 3].mean(0), average_up(cameras), looked_at(cameras, focus_depth)
    base = look_at(center, target, up)
    local = (poses[:, :3, 3] - center) @ base[:3, :3]
    reach = np.percentile(np.abs(local), 80, axis=0)
    angle = 4 * np.pi * share
    offset = reach * np.array([np.cos(angle), -np.sin(angle), -np.sin(angle / 2)]) * np.array([1, 1, 0.5])
    return look_at(center + base[:3, :3] @ offset, target, up)


def _between_pose(cameras: list[Camera], share: float) -> np.ndarray:
    """Return a pose on a path through all cameras, from neighbor to neighbor."""
    order = _tour(np.array([c.center for c in cameras]))
    return spline_pose(np.array([cameras[i].world_from_camera for i in order]), share)


def spline_pose(poses: np.ndarray, share: float) -> np.ndarray:
    """Interpolate a pose [4, 4] at `share` of the way through poses [n, 4, 4], in order, equally spaced.

    Catmull-Rom for centers, slerp for rotations. share: 0 at the first pose, 1 at the last.
    """
    from scipy.spatial.transform import Rotation, Slerp

    if not len(poses):
        raise InvalidValue("a camera path needs a pose to pass through; there are none")
    if len(poses) == 1:
        return poses[0]
    at = share * (len(poses) - 1)
    k = min(int(at), len(poses) - 2)
    points = poses[np.clip([k - 1, k, k + 1, k + 2], 0, len(poses) - 1), :3, 3]
    pose = np.eye(4)
    pose[:3, 3] = _catmull_rom(points, at - k)
    turns = Slerp([0, 1], Rotation.from_matrix(poses[k : k + 2, :3, :3]))
    pose[:3, :3] = turns(at - k).as_matrix()
    return pose


def _catmull_rom(p: np.ndarray, u: float) -> np.ndarray:
    return 0.5 * (
        2 * p[1]
        + (p[2] - p[0]) * u
        + (2 * p[0] - 5 * p[1] + 4 * p[2] - p[3]) * u**2
        + (3 * p[1] - p[0] - 3 * p[2] + p[3]) * u**3
    )


def _tour(centers: np.ndarray) -> list[int]:
    """Return a tour of all cameras: always the nearest unvisited one, starting from an outermost one."""
    left = set(range(len(centers)))
    here = int(np.argmax(np.linalg.norm(centers - centers.mean(0), axis=1)))
    order = [here]
    left.remove(here)
    while left:
        here = min(left, key=lambda i: (float(np.linalg.norm(centers[i] - centers[here])), i))
        order.append(here)
        left.remove(here)
    return order


def _unit(vector: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vector)
    if length < 1e-12:
        raise InvalidValue("a direction has zero length: cameras coincide or face each other")
    return vector / length
