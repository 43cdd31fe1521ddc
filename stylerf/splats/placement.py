"""Place 3D Gaussians on points of a field's surfaces, drawn from the same samples as its images.

Points are thinned by cells of the field's space, finer where images have detail. Cells of that space are about as large
as a pixel's footprint at every depth.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter, sobel
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from stylerf.errors import InvalidValue
from stylerf.fields.marching import ScratchArena
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.cameras import Camera
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.geometry.spherical_harmonics import BANDS, C0
from stylerf.kernels.cpu.ray_samples import Rays
from stylerf.kernels.cpu.splat_placement import draw_samples
from stylerf.kernels.cpu.splats import Gaussians
from stylerf.rendering.rays import Rendered, render_rays
from stylerf.rendering.view import RAYS_AT_ONCE

SURFACE_PIXELS = 4.0  # half the thickness of a surface
FINEST = 2048  # maximum cells per side
COARSE_SHARE = 0.6  # maximum fraction of the Gaussians for uniform coverage; the rest is for detail
NEIGHBORS = 8
SPREAD, FLATNESS = 0.6, 0.3  # standard deviation along the surface, relative to the spacing; across, relative to that
FARTHEST_NEIGHBOR = 4.0  # maximum spacing of an isolated point, relative to its neighbors'
OPACITIES = 0.1, 0.95


@dataclass(frozen=True)
class SurfacePoints:
    """Surface points visible in images.

    Attributes:
        centers: [n, 3] float32, scene units.
        colors: [n, 3] float32 in 0..1, sRGB-encoded.
        opacities: [n] float32 in 0..1, of the surface that contains the point.
        detail: [n] float32, local image contrast, nonnegative.
    """

    centers: np.ndarray
    colors: np.ndarray
    opacities: np.ndarray
    detail: np.ndarray

    @staticmethod
    def joined(parts: "list[SurfacePoints]") -> "SurfacePoints":
        """Return the points of all parts."""
        names = "centers", "colors", "opacities", "detail"
        return SurfacePoints(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def picture_and_points(
    field: RadianceField, camera: Camera, farthest: float, generator: np.random.Generator, threads: int
) -> tuple[np.ndarray, SurfacePoints]:
    """Render a view and draw one point per ray from its weights: an opaque pixel gives one, an empty one none.

    Semi-transparent parts get their share, since a ray draws from all of its samples.

    Args:
        farthest: distance, scene units, to which an opaque background is moved; rays reach it at 1e3 or more.

    Returns:
        [h, w, 4] float32: premultiplied rgb, sRGB-encoded, and alpha; and the points.
    """
    count, arena = camera.width * camera.height, ScratchArena()
    out = np.empty((count, 4), np.float32)
    draws = generator.random(count, dtype=np.float32)
    parts: list[tuple[np.ndarray, ...]] = []
    for at in range(0, count, RAYS_AT_ONCE):
        pixels = np.arange(at, min(at + RAYS_AT_ONCE, count))
        pixels = pixels[np.argsort(pixels // camera.width % threads, kind="stable")]  # as in render_view()
        rays = Rays.of(*camera.rays(pixels), field.space.near)
        rendered = render_rays(
            field, rays, threads=threads, weight_threshold=field.weight_threshold, arena=arena.reset()
        )
        out[pixels] = rendered.out[:, :4]
        reach = np.float32(SURFACE_PIXELS / camera.fx)
        chosen, opacities = np.empty(len(pixels), np.int64), np.empty(len(pixels), np.float32)
        draw_samples(rendered.samples, draws[pixels], reach, threads, chosen, opacities)
        hit = chosen >= 0
        distances = np.minimum(rendered.samples.t[chosen[hit]], farthest)
        centers = rays.origins[hit] + rays.directions[hit] * distances[:, None]
        parts.append((pixels[hit], centers, _colors(field, rendered, hit, chosen[hit]), opacities[hit]))
    picture = out.reshape(camera.height, camera.width, 4)
    picture[..., 3] = np.clip(picture[..., 3], 0, 1)
    pixels, centers, colors, opacities = (np.concatenate(part) for part in zip(*parts, strict=True))
    order = np.argsort(pixels)  # independent of the number of threads
    detail = _contrast(picture).reshape(-1)[pixels]
    found = [centers.astype(np.float32), colors.astype(np.float32), opacities, detail]
    return picture, SurfacePoints(*(values[order] for values in found))


def _colors(field: RadianceField, rendered: Rendered, hit: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Return the colors [n, 3] of the chosen samples; uncolored ones get their ray's mean, as in compositing."""
    colors = rendered.colors[chosen]
    mean = rendered.unmapped[hit, :3] / np.maximum(rendered.unmapped[hit, 3:4], 1e-6)
    colors = np.where(colors[:, :1] < 0, mean, colors)
    if field.color_map is not None:
        colors = colors @ field.color_map.matrix.numpy().T + field.color_map.offset.numpy()
    return np.clip(colors, 0, 1)


def _contrast(picture: np.ndarray) -> np.ndarray:
    """Return the gradient magnitude of an image [h, w, 4], the maximum within a pixel, [h, w]."""
    squares = sum(sobel(picture[..., channel], axis) ** 2 for channel in range(4) for axis in (0, 1))
    return maximum_filter(np.sqrt(squares), 3)


def thinned(points: SurfacePoints, space: SpaceWarp, most: int) -> SurfacePoints:
    """Merge the points in each cell; in detailed parts, cells have half the side length.

    Args:
        points: at least one.
        most: maximum number of points to return.
    """
    if not len(points.centers):
        raise InvalidValue("the field shows nothing in its views: there is no surface to place splats on")
    cube = space.warp(points.centers)
    side = float(FINEST)
    while True:
        cells = np.maximum(space.cells_per_axis(max(int(side), 8)) // 2, 1)
        coarse, members = np.unique(_cell_numbers(cube, cells), return_inverse=True)
        if len(coarse) <= max(COARSE_SHARE * most, 1) or side < 8:
            break
        side *= max(0.9 * np.sqrt(COARSE_SHARE * most / len(coarse)), 0.5) if len(coarse) > 2 * most else 0.9
    fine, at, fine_members = np.unique(_cell_numbers(cube, 2 * cells), return_index=True, return_inverse=True)
    detail = np.bincount(members, points.detail) / np.bincount(members)
    order = np.argsort(-detail, kind="stable")
    # Total number of points if the k most detailed cells are split.
    totals = len(coarse) + np.cumsum(np.bincount(members[at])[order] - 1)
    split = np.zeros(len(coarse), bool)
    split[order[: np.searchsorted(totals, most, side="right")]] = True
    _, groups = np.unique(np.where(split[members], fine_members, len(fine) + members), return_inverse=True)
    return SurfacePoints(
        _means(points.centers, groups), _means(points.colors, groups), _means(points.opacities, groups),
        _means(points.detail, groups),
    )  # fmt: skip


def on_surfaces(points: SurfacePoints, degree: int, threads: int) -> Gaussians:
    """Return a flat Gaussian at each point, facing along the normal of its neighbors, as wide as their spacing.

    Args:
        points: at least one.
        degree: of the spherical harmonics; those above the constant one are 0.
    """
    centers = points.centers.astype(np.float64)
    count = min(NEIGHBORS + 1, len(centers))
    distances, neighbors = cKDTree(centers).query(centers, k=count, workers=threads)
    distances, neighbors = distances.reshape(len(centers), count), neighbors.reshape(len(centers), count)
    spacing = np.sqrt(np.mean(distances[:, 1:5] ** 2, axis=1)) if count > 1 else np.full(len(centers), 1e-2)
    spacing = np.minimum(spacing, FARTHEST_NEIGHBOR * np.median(spacing[neighbors], axis=1))
    spread = SPREAD * np.maximum(spacing, 1e-6 * max(float(np.ptp(centers)), 1e-6))
    around = centers[neighbors] - centers[neighbors].mean(1, keepdims=True)
    _, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around))
    axes = axes[:, :, ::-1].copy()  # the normal, the direction of least variance, is last
    axes[:, :, 2] *= np.sign(np.linalg.det(axes))[:, None]
    opacities = np.clip(points.opacities, *OPACITIES)
    harmonics = np.zeros((len(centers), BANDS[degree], 3), np.float32)
    harmonics[:, 0] = (points.colors - 0.5) / C0
    return Gaussians(
        points.centers,
        np.log(np.stack([spread, spread, FLATNESS * spread], -1)).astype(np.float32),
        Rotation.from_matrix(axes).as_quat(scalar_first=True).astype(np.float32),
        np.log(opacities / (1 - opacities)).astype(np.float32),
        harmonics,
    )


def _cell_numbers(cube: np.ndarray, cells: np.ndarray) -> np.ndarray:
    x = np.minimum((cube * cells).astype(np.int64), cells - 1)
    return (x[:, 0] * cells[1] + x[:, 1]) * cells[2] + x[:, 2]


def _means(values: np.ndarray, groups: np.ndarray) -> np.ndarray:
    """Return the means of values [n] or [n, c] by group."""
    counts = np.bincount(groups)
    columns = values.reshape(len(values), -1).T
    means = np.stack([np.bincount(groups, column) / counts for column in columns], -1).astype(np.float32)
    return means.reshape(len(counts), *values.shape[1:])
