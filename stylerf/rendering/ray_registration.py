"""Ray registration: which pixels of a view see the same surface as a reference view, and where in its image.

Ref-NPR (Zhang et al. 2023, section 3.2) stores the reference's points in a grid of 512^3 voxels, where the other views
look up their points. Here, a point is projected into the reference view and compared with the point seen at that
pixel: the same test without a grid, so the position in the image is exact.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stylerf.fields.packed_surface import PackedSurface, surface_of
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.cameras import Camera
from stylerf.geometry.space_warp import SpaceWarp

TOLERANCE = 1 / 128  # of the unit cube; points farther apart are on different surfaces, or on different sides of one
MIN_COSINE = 0.3  # between the two rays (Ref-NPR)
SOLID = 0.5  # minimum alpha for a pixel to see a surface
FEW_PIXELS = 2000  # per view; enough to estimate how much of it another view sees


@dataclass(frozen=True)
class SeenPoints:
    """The surface points seen by a view's pixels, in row-major order.

    Attributes:
        camera: the view.
        points: [n, 3], world space.
        places: [n, 3], the same points in the unit cube.
        there: [n] bool, whether the pixel sees a surface.
    """

    camera: Camera
    points: np.ndarray
    places: np.ndarray
    there: np.ndarray


def points_of(surface: PackedSurface, camera: Camera, space: SpaceWarp) -> SeenPoints:
    """Return the surface point of each pixel: the weighted mean of the samples within TOLERANCE of the median.

    Depth has the same definition (decision 0032). Only for fields without a displacement.
    """
    count = camera.height * camera.width
    starts, ends, x, weights = surface.samples(np.arange(count))
    # Two passes of cumulative sums over all samples: the first finds each pixel's median, the second its local mean.
    sums = np.zeros((len(x) + 1, 4))
    np.cumsum(weights, dtype=np.float64, out=sums[1:, 3])
    middle = np.searchsorted(sums[1:, 3], (sums[starts, 3] + sums[ends, 3]) / 2)
    away = x - np.repeat(x[np.minimum(middle, max(len(x) - 1, 0))], ends - starts, 0) if len(x) else x
    weights = weights * (np.linalg.norm(away, axis=1) <= TOLERANCE)
    np.cumsum(np.concatenate([x * weights[:, None], weights[:, None]], 1), axis=0, dtype=np.float64, out=sums[1:])
    of_pixel = sums[ends] - sums[starts]
    places = of_pixel[:, :3] / np.maximum(of_pixel[:, 3:], 1e-9)
    there = surface.alpha.ravel() > SOLID
    return SeenPoints(camera, space.unwarp(places), places, there)


def registered(view: SeenPoints, reference: SeenPoints, tolerance: float = TOLERANCE) -> tuple[np.ndarray, ...]:
    """Register a view's pixels in a reference view.

    A pixel is registered if its point projects into the reference image, the pixel there sees a point within
    `tolerance` of it (cube units), and both rays see the same side (cosine >= MIN_COSINE).

    Returns:
        (pixels [n] of the view, positions [n, 2] in the reference image, cosines [n] between the two rays).
    """
    camera = reference.camera
    pixels = np.flatnonzero(view.there)
    points = view.points[pixels]
    positions, depth = camera.project(points)
    # Points near the camera plane project so far away that a cast to integers would be undefined.
    columns, rows = np.floor(np.clip(positions, -1, 1e7)).astype(np.int64).T
    inside = (depth > 0) & (columns >= 0) & (rows >= 0) & (columns < camera.width) & (rows < camera.height)
    at = np.where(inside, rows * camera.width + columns, 0)
    # The interpolated point, or the nearest pixel's where a neighbor sees a different surface.
    seen = sampled_at(reference.places.reshape(camera.height, camera.width, 3), positions)
    apart = np.minimum(*(np.linalg.norm(view.places[pixels] - there, axis=1) for there in (seen, reference.places[at])))
    cosines = (_ways(points, view.camera) * _ways(points, camera)).sum(1)
    chosen = inside & reference.there[at] & (apart <= tolerance) & (cosines >= MIN_COSINE)
    return pixels[chosen], positions[chosen], cosines[chosen]


def _ways(points: np.ndarray, camera: Camera) -> np.ndarray:
    """Return unit directions [n, 3] from the camera to the points."""
    way = points - camera.center
    return way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-12)


def few_points(
    field: RadianceField, cameras: Sequence[Camera], weight_threshold: float, threads: int
) -> list[SeenPoints]:
    """Return the surface points of about FEW_PIXELS pixels of each view."""
    found = []
    for camera in cameras:
        stride = max(1, round((camera.width * camera.height / FEW_PIXELS) ** 0.5))
        surface = surface_of(field, camera, weight_threshold, threads, stride=stride)
        found.append(points_of(surface, every(camera, stride), field.space))
    return found


def every(camera: Camera, stride: int) -> Camera:
    """Return the camera whose pixel (i, j) is pixel (stride i, stride j) of `camera`."""
    return replace(
        camera,
        width=-(-camera.width // stride),
        height=-(-camera.height // stride),
        fx=camera.fx / stride,
        fy=camera.fy / stride,
        cx=(camera.cx - 0.5) / stride + 0.5,  # pixel centers are at halves
        cy=(camera.cy - 0.5) / stride + 0.5,
    )


def best_reference(views: Sequence[SeenPoints]) -> int:
    """Return the index of the view in which, on average, the largest fraction of the views' pixels is registered."""
    shares = []
    for candidate in views:
        found = [len(registered(other, candidate)[0]) / max(1, other.there.sum()) for other in views]
        shares.append(np.mean(found))
    return int(np.argmax(shares))


def sampled_at(picture: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Bilinearly sample an image [h, w, c] at positions [n, 2] (x, y; pixel centers at halves), clamped: [n, c]."""
    height, width = picture.shape[:2]
    x = np.clip(positions[:, 0] - 0.5, 0, width - 1)
    y = np.clip(positions[:, 1] - 0.5, 0, height - 1)
    left, top = np.minimum(x.astype(np.int64), max(0, width - 2)), np.minimum(y.astype(np.int64), max(0, height - 2))
    right, below = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    across, down = (x - left)[:, None].astype(np.float32), (y - top)[:, None].astype(np.float32)
    upper = picture[top, left] * (1 - across) + picture[top, right] * across
    lower = picture[below, left] * (1 - across) + picture[below, right] * across
    return upper * (1 - down) + lower * down
