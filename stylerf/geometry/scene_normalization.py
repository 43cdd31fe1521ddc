"""The layout of a capture, and the similarity transform and bounds that normalize it to scene units.

Similarities are [4, 4] (scale * rotation | translation), scene_from_source. Poses are world_from_camera, OpenCV axes.
"""

from dataclasses import dataclass

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.geometry.cameras import Camera

# A capture is forward-facing if 95 % of its viewing axes are within this angle, degrees, of their mean. LLFF's captures
# have about 10, walks around an object 50 and more.
FORWARD_SPREAD = 25.0
MOST_DEPTHS = 20_000_000  # of points in views, 0.7 GB; enough for a percentile
# Near plane of a forward-facing capture, as a fraction of the nearest known depth; becomes 1 scene unit.
FORWARD_NEAR = 0.75
UNBOUNDED_NEAR, UNBOUNDED_FAR = 0.05, 1e3
# Camera centers closer than this, relative to their largest coordinate, differ only by rounding: two steps of single
# precision, in which many tools store poses. At the origin: rounding of rotations in double precision.
ONE_POINT, ONE_POINT_AT_ORIGIN = 2.4e-7, 1e-12
# Minimum baseline relative to the nearest depth: 0.01 pixels of parallax at a focal length of 1,000 pixels.
MIN_PARALLAX = 1e-5


@dataclass(frozen=True)
class Layout:
    """A layout (`object`, `forward` or `unbounded`) and the reason as text."""

    name: str
    reason: str


def axes_spread(poses: np.ndarray) -> float:
    """Return the 95th percentile of the angles between viewing axes and their mean, degrees."""
    forward = poses[:, :3, 2]
    mean = forward.sum(0) / max(np.linalg.norm(forward.sum(0)), 1e-12)
    return float(np.percentile(np.degrees(np.arccos(np.clip(forward @ mean, -1, 1))), 95))


def decided_layout(poses: np.ndarray, cut_out: str) -> Layout:
    """Choose the layout of a capture. cut_out: text that names what separates object and background, or ""."""
    if cut_out:
        return Layout("object", f"the object is cut out by {cut_out}")
    spread = axes_spread(poses)
    if spread <= FORWARD_SPREAD:
        return Layout("forward", f"the viewing axes are within {spread:.0f} degrees of their mean")
    return Layout(
        "unbounded", f"the viewing axes spread {spread:.0f} degrees about their mean and nothing cuts the object out"
    )


def baseline_of(poses: np.ndarray) -> float:
    """Return the largest distance of a camera from the mean; raises InvalidValue if all cameras are at one point."""
    centers = poses[:, :3, 3]
    baseline = float(np.linalg.norm(centers - centers.mean(0), axis=1).max())
    largest = float(np.abs(centers).max())
    if not baseline > max(ONE_POINT * largest, ONE_POINT_AT_ORIGIN):
        raise InvalidValue(
            f"all cameras are at one point (within {baseline:.2g}, at coordinates up to {largest:.2g}): without a "
            "baseline there is no depth"
        )
    return baseline


def check_baseline(poses: np.ndarray, near_far: np.ndarray | None, points: np.ndarray | None) -> None:
    """Raise InvalidValue if the cameras are at one point, exactly or relative to the nearest depth."""
    baseline, (nearest, known) = baseline_of(poses), nearest_depth(poses, near_far, points)
    if baseline < MIN_PARALLAX * nearest:
        raise InvalidValue(
            f"all cameras are at one point: within {baseline:.3g}, while the nearest depth is {nearest:.3g} by {known}"
        )


def focus_of(poses: np.ndarray) -> np.ndarray:
    """Return the least-squares intersection of all viewing axes, [3].

    For nearly parallel axes, the point on the mean axis at four times the spread of the centers.
    """
    centers, forward = poses[:, :3, 3], poses[:, :3, 2]
    across = np.eye(3) - forward[:, :, None] * forward[:, None, :]  # [n, 3, 3]
    total = across.sum(0)
    middle, spread = centers.mean(0), baseline_of(poses)
    # The smallest eigenvalue divided by the number of axes is the mean squared sine of their angles to a common axis.
    if np.linalg.eigvalsh(total)[0] / len(poses) > 1e-4:
        focus = np.linalg.solve(total, (across @ centers[:, :, None]).sum(0)[:, 0])
        if ((focus - centers) * forward).sum(1).mean() > 0:
            return focus
    mean = forward.mean(0)
    return middle + 4 * spread * mean / max(np.linalg.norm(mean), 1e-12)


def up_of(poses: np.ndarray) -> np.ndarray:
    """Return the up direction, a unit vector [3]: perpendicular to the cameras' x axes, assuming level cameras.

    If these axes are all parallel or cameras are rolled, the mean of the cameras' own up directions.
    """
    sideways, mean = poses[:, :3, 0], -poses[:, :3, 1].mean(0)
    values, vectors = np.linalg.eigh(sideways.T @ sideways / len(poses))
    level = vectors[:, 0] * (1 if vectors[:, 0] @ mean >= 0 else -1)
    if values[1] < 0.05 or values[0] > 0.3 * values[1]:
        level = mean
    length = np.linalg.norm(level)
    return level / length if length > 1e-6 else np.array([0.0, 0.0, 1.0])


def rotation_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the smallest rotation [3, 3] that maps unit vector a to b."""
    axis, cosine = np.cross(a, b), float(a @ b)
    if cosine < -1 + 1e-9:  # a half turn, about any perpendicular axis
        other = np.eye(3)[np.argmin(np.abs(a))]
        axis = np.cross(a, other) / np.linalg.norm(np.cross(a, other))
        return 2 * np.outer(axis, axis) - np.eye(3)
    # Rodrigues' formula, I + K + K^2 / (1 + cos).
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + cross + cross @ cross / (1 + cosine)


def similarity(scale: float, rotation: np.ndarray, center: np.ndarray) -> np.ndarray:
    """Return the transform x -> scale * rotation (x - center) as [4, 4]."""
    matrix = np.eye(4)
    matrix[:3, :3] = scale * rotation
    matrix[:3, 3] = -scale * rotation @ center
    return matrix


def moved(pose: np.ndarray, scene_from_source: np.ndarray) -> np.ndarray:
    """Apply a similarity to a pose [4, 4], without scaling its rotation."""
    scale = np.cbrt(np.linalg.det(scene_from_source[:3, :3]))
    out = scene_from_source @ pose
    out[:3, :3] /= scale
    return out


def centered(poses: np.ndarray) -> np.ndarray:
    """Return the similarity [4, 4] that normalizes a capture around a focus: origin, up +z, median distance 1."""
    focus = focus_of(poses)
    distance = float(np.median(np.linalg.norm(poses[:, :3, 3] - focus, axis=1)))
    if distance <= ONE_POINT * baseline_of(poses):
        raise InvalidValue("most cameras are at the point that they look at; check the convention of the poses")
    return similarity(1 / distance, rotation_between(up_of(poses), np.array([0.0, 0.0, 1.0])), focus)


def facing(poses: np.ndarray, nearest: float) -> np.ndarray:
    """Return the similarity [4, 4] that normalizes a forward-facing capture: mean camera at the origin, along +z.

    Image y is down. The near plane, at FORWARD_NEAR times the nearest depth, is at 1.
    """
    forward = poses[:, :3, 2].mean(0)
    if np.linalg.norm(forward) < 1e-6:
        raise InvalidValue("the cameras look in opposite directions: no layout of forward-facing cameras fits them")
    forward /= np.linalg.norm(forward)
    right = np.cross(poses[:, :3, 1].mean(0), forward)
    if np.linalg.norm(right) < 1e-6:  # cameras rolled in all directions have no common down direction
        right = np.cross(np.eye(3)[np.argmin(np.abs(forward))], forward)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return similarity(1 / (FORWARD_NEAR * nearest), rotation, poses[:, :3, 3].mean(0))


def nearest_depth(poses: np.ndarray, near_far: np.ndarray | None, points: np.ndarray | None) -> tuple[float, str]:
    """Return the nearest depth in a forward-facing capture, source units, and text that names its source.

    Args:
        poses: [n, 4, 4].
        near_far: [n, 2], planar depth bounds of each camera, if known.
        points: [m, 3], sparse points, if known. Without either, the baseline is used.
    """
    if near_far is not None:
        return float(near_far[:, 0].min()), "the depth bounds in the files"
    if points is not None and len(points) >= 50:
        some = points[:: -(-len(points) * len(poses) // MOST_DEPTHS)]
        depths = np.concatenate([(some - pose[:3, 3]) @ pose[:3, 2] for pose in poses])
        if (depths > 0).mean() > 0.5:
            return float(np.percentile(depths[depths > 0], 0.5)), "the sparse points"
    return baseline_of(poses), "the baseline of the cameras"


def frustum_box(cameras: list[Camera], near: float, far: float) -> np.ndarray:
    """Return the bounding box [2, 3] of all that forward-facing cameras see between planar depths near and far."""
    corners = []
    for camera in cameras:
        w, h = camera.width, camera.height
        pixels = np.array([[0, 0], [w, 0], [0, h], [w, h]], dtype=np.float64)
        corners += [camera.unproject(pixels, np.full(4, depth)) for depth in (near, far)]
    every = np.concatenate(corners)
    box = np.stack([every.min(0), every.max(0)])
    box[0, 2] = max(box[0, 2], near)
    return box


def depths_of_box(cameras: list[Camera], box: np.ndarray) -> tuple[float, float]:
    """Return the planar depths (near, far) that enclose the box [2, 3] for all cameras; near is at least far / 1000."""
    corners = np.array([[box[i, 0], box[j, 1], box[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    depths = np.concatenate([camera.project(corners)[1] for camera in cameras])
    far = float(depths.max())
    if far <= 0:
        raise InvalidValue("the object is behind every camera; check the convention of the poses")
    return max(float(depths.min()), far * 1e-3), far
