"""Colors of surface points as seen by the cameras that see them."""

import numpy as np

from stylerf.fields.radiance_field import RadianceField
from stylerf.kernels.cpu.ray_samples import Rays
from stylerf.rendering.rays import render_rays
from stylerf.surfaces.visibility import DepthView

CAMERAS = 3  # number of cameras to average: those that look at a point most directly
RAYS_AT_ONCE = 8192
_DIFFERENCE = 1e-4  # of a ray's length, to estimate the warp's speed along it


def vertex_colors(
    field: RadianceField,
    points: np.ndarray,
    normals: np.ndarray,
    views: list[DepthView],
    tolerance: float,
    threads: int,
) -> np.ndarray:
    """Return the colors of points as seen by camera rays, [n, 3] in 0..1, sRGB-encoded.

    A ray starts just in front of its point, so that occluders do not matter. The colors of up to CAMERAS cameras are
    averaged, weighted by the squared cosine of their angle to the normal. A point that no camera sees is colored along
    its normal.

    Args:
        points, normals: [n, 3], scene units and unit length.
        views: cameras with their depth.
        tolerance: cube units; how far in front of a point its ray starts, and how far a visible point may be behind the
            visible surface.
    """
    facing = np.stack([one.facing(points, normals, field.space, tolerance) for one in views])  # [views, n]
    centers = np.array([one.camera.center for one in views])
    sums, weights = np.zeros((len(points), 3)), np.zeros(len(points))
    for rank in range(min(CAMERAS, len(views))):
        best = np.argsort(-facing, axis=0, kind="stable")[rank]
        weight = facing[best, np.arange(len(points))] ** 2
        seen = np.flatnonzero(weight)
        colors = _seen_from(field, points[seen], centers[best[seen]], tolerance, threads)
        sums[seen] += weight[seen, None] * colors
        weights[seen] += weight[seen]
    unseen = np.flatnonzero(weights == 0)
    away = np.linalg.norm(points[unseen] - centers.mean(0), axis=1, keepdims=True)
    sums[unseen] = _seen_from(field, points[unseen], points[unseen] + normals[unseen] * away, tolerance, threads)
    weights[unseen] = 1
    return np.clip(sums / weights[:, None], 0, 1)


def _seen_from(
    field: RadianceField, points: np.ndarray, eyes: np.ndarray, tolerance: float, threads: int
) -> np.ndarray:
    """Return the colors [n, 3] of points [n, 3], each seen from its own eye [n, 3]."""
    rays = points - eyes
    lengths = np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-12)
    moved = field.space.warp(points) - field.space.warp(points - _DIFFERENCE * rays)
    speeds = np.maximum(np.abs(moved).max(1) / (_DIFFERENCE * lengths[:, 0]), 1e-12)  # cube units per scene unit
    near = np.maximum(lengths[:, 0] - tolerance / speeds, 0)
    out = np.empty((len(points), 3))
    for at in range(0, len(points), RAYS_AT_ONCE):
        part = slice(at, at + RAYS_AT_ONCE)
        origins = np.ascontiguousarray(eyes[part], np.float32)
        directions = np.ascontiguousarray(rays[part] / lengths[part], np.float32)
        jitter = np.full(len(origins), 0.5, np.float32)
        batch = Rays(origins, directions, jitter, near[part].astype(np.float32))
        seen = render_rays(field, batch, threads=threads, weight_threshold=field.weight_threshold).out
        out[part] = seen[:, :3] / np.maximum(seen[:, 3:4], 1e-3)
    return out
