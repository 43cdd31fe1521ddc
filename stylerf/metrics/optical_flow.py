"""Optical flow between two views: computed from a field's depth and poses, used for warping, with occlusion checks.

A flow [h, w, 2] holds, for each pixel of an image, the displacement (right, down), pixels, of its content in another
image of the same size; NaN or infinity where unknown.
"""

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.geometry.cameras import Camera
from stylerf.metrics.consistency import PosedView


def field_flow(view: PosedView, other: Camera) -> np.ndarray:
    """Return the flow [h, w, 2] float64 from a view to another camera, from the view's depth.

    NaN where alpha is at most 0.5, the depth is unknown, or the point is behind the other camera. Occlusion is ignored.
    """
    camera = view.camera
    rows, columns = np.meshgrid(np.arange(camera.height) + 0.5, np.arange(camera.width) + 0.5, indexing="ij")
    known = ((view.alpha > 0.5) & np.isfinite(view.z) & (view.z > 0)).reshape(-1)
    depth = np.where(known, view.z.reshape(-1), 1.0).astype(np.float64)
    here = np.stack([columns.reshape(-1), rows.reshape(-1)], axis=-1)
    there, z = other.project(camera.unproject(here, depth))
    known &= z > 0
    return np.where(known[:, None], there - here, np.nan).reshape(camera.height, camera.width, 2)


def filled(flow: np.ndarray) -> np.ndarray:
    """Replace unknown flow with 0, which is correct for uniform backgrounds, since they appear static."""
    return np.where(np.isfinite(flow).all(axis=-1, keepdims=True), flow, 0.0)


def sampled(values: np.ndarray, flow: np.ndarray) -> np.ndarray:
    """Sample values [h, w, c] bilinearly at each pixel displaced by `flow` [h, w, 2].

    Zero outside; within one pixel beyond the outermost centers, the value fades to 0 (OpenCV's constant border).
    """
    check_flow(flow, values.shape[:2])
    height, width = values.shape[:2]
    rows, columns = np.meshgrid(np.arange(height), np.arange(width), indexing="ij")
    moved = filled(flow)
    padded = np.pad(np.asarray(values, np.float64), ((2, 2), (2, 2), (0, 0)))  # -1 and its left neighbor are zero
    x = np.clip(columns + moved[..., 0], -1.5, width + 0.5) + 2
    y = np.clip(rows + moved[..., 1], -1.5, height + 0.5) + 2
    left, top = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    u, v = (x - left)[..., None], (y - top)[..., None]
    upper = padded[top, left] * (1 - u) + padded[top, left + 1] * u
    lower = padded[top + 1, left] * (1 - u) + padded[top + 1, left + 1] * u
    return upper * (1 - v) + lower * v


def inside(flow: np.ndarray) -> np.ndarray:
    """Return where the flow is known and ends between the centers of the outermost pixels, [h, w] bool."""
    height, width = flow.shape[:2]
    rows, columns = np.meshgrid(np.arange(height), np.arange(width), indexing="ij")
    with np.errstate(invalid="ignore"):
        x, y = columns + flow[..., 0], rows + flow[..., 1]
        return (x >= 0) & (y >= 0) & (x <= width - 1) & (y <= height - 1)


def occluded(first: np.ndarray, second: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Return where two flows do not cancel, or `edges` has an edge, [h, w] bool (Ruder et al. 2016, section 3.2).

    |a + b|^2 > 0.01 (|a|^2 + |b|^2) + 0.5, or |grad e|^2 > 0.01 |e|^2 + 0.002, with forward differences, 0 at the last
    pixel. All [h, w, 2]; `second` is sampled by `first`.
    """
    apart = _squared(first + second) > 0.01 * (_squared(first) + _squared(second)) + 0.5
    gradient = np.zeros(edges.shape[:2])
    gradient[:, :-1] += _squared(edges[:, 1:] - edges[:, :-1])
    gradient[:-1] += _squared(edges[1:] - edges[:-1])
    return apart | (gradient > 0.01 * _squared(edges) + 0.002)


def visible(forward: np.ndarray, backward: np.ndarray) -> np.ndarray:
    """Return which pixels of the target are visible in the source, [h, w] bool.

    A pixel is visible if its backward flow (target to source) is known and ends within the source, the forward flow
    (source to target) there leads back, and the backward flow has no edge.
    """
    check_flow(forward, backward.shape[:2])
    back = filled(backward)
    # Unknown flow at a source pixel invalidates everything interpolated from it.
    known = sampled(np.isfinite(forward).all(axis=-1, keepdims=True).astype(np.float64), back)[..., 0] > 1 - 1e-9
    return inside(backward) & known & ~occluded(back, sampled(filled(forward), back), back)


def check_flow(flow: np.ndarray, size: tuple[int, ...]) -> None:
    """Raise InvalidValue unless the flow has shape [*size, 2]."""
    if flow.shape != (*size, 2):
        raise InvalidValue(f"expected a flow of {size[1]}x{size[0]} pixels, got an array of shape {flow.shape}")


def _squared(vectors: np.ndarray) -> np.ndarray:
    return np.asarray(np.square(vectors, dtype=np.float64).sum(axis=-1))
