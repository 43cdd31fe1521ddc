"""Render whole views of a field; visualize their depth and displacement."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.fields.marching import ScratchArena
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.cameras import Camera
from stylerf.kernels.cpu.ray_samples import Rays
from stylerf.rendering.rays import Rendered, alpha_inside, render_rays, with_surface_distance

RAYS_AT_ONCE = 8192


@dataclass(frozen=True)
class RenderedView:
    """The images of one view.

    Attributes:
        rgb: [h, w, 3], sRGB-encoded, premultiplied (sum of w c, no background).
        alpha: [h, w], 0..1.
        ray_distance: [h, w], along the ray to the visible surface (decision 0032), scene units, 0 where alpha is 0.
        z: [h, w], planar depth of the same point, along the viewing axis.
        masks: [h, w] by region, its contribution to alpha, 0..alpha.
    """

    rgb: np.ndarray
    alpha: np.ndarray
    ray_distance: np.ndarray
    z: np.ndarray
    masks: dict[str, np.ndarray] = field(default_factory=dict)


def render_view(
    field: RadianceField,
    camera: Camera,
    *,
    threads: int,
    min_transmittance: float = 1e-3,
    rays_at_once: int = RAYS_AT_ONCE,
    regions: Mapping[str, np.ndarray] | None = None,
    on_rays: Callable[[int], None] = lambda done: None,
    on_rendered: Callable[[np.ndarray, Rendered], None] = lambda pixels, rendered: None,
) -> RenderedView:
    """Render every pixel center of a camera.

    Args:
        min_transmittance: transmittance below which a ray terminates.
        rays_at_once: batch size, which bounds memory.
        regions: marked cells [s, s, s] bool by name; masks are computed from the same samples as the image.
        on_rays: called after each batch with the number of rays done.
        on_rendered: called with each batch's pixels and rendered samples, which are invalid after it returns.
    """
    count = camera.width * camera.height
    out = np.empty((count, 5), np.float32)
    marked = regions or {}
    inside = {name: np.empty(count, np.float32) for name in marked}
    arena = ScratchArena()
    for at in range(0, count, rays_at_once):
        pixels = np.arange(at, min(at + rays_at_once, count))
        # Distribute rows to threads round-robin: the upper half of an image is often emptier than the lower.
        pixels = pixels[np.argsort(pixels // camera.width % threads, kind="stable")]
        rays = Rays.of(*camera.rays(pixels), field.space.view_start(camera.center))
        rendered = render_rays(
            field,
            rays,
            threads=threads,
            min_transmittance=min_transmittance,
            weight_threshold=field.weight_threshold,
            arena=arena.reset(),  # nothing of the last batch is used any more
        )
        out[pixels] = with_surface_distance(rendered, threads)
        for name, mask in inside.items():
            mask[pixels] = alpha_inside(marked[name], rendered.samples, threads)
        on_rendered(pixels, rendered)
        on_rays(min(at + rays_at_once, count))
    return view_of(camera, out, inside)


def view_of(camera: Camera, out: np.ndarray, inside: Mapping[str, np.ndarray]) -> RenderedView:
    """Arrange rendered pixels as images.

    Args:
        out: [pixels, 5]: premultiplied rgb, alpha, surface distance.
        inside: [pixels] by region, its contribution to alpha.
    """
    out = np.where(camera.has_ray()[..., None], out.reshape(camera.height, camera.width, 5), np.float32(0))
    alpha = np.clip(out[..., 3], 0, 1)
    distance = np.where(alpha > 0, out[..., 4], 0)
    masks = {name: np.minimum(mask.reshape(alpha.shape), alpha) for name, mask in inside.items()}
    return RenderedView(out[..., :3], alpha, distance, distance * camera.ray_cosines(), masks)


def depth_picture(z: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Visualize planar depth [h, w] as inverse depth in viridis, near is bright: [h, w, 3] uint8, black where empty."""
    from stylerf.environment.matplotlib_defaults import colormaps

    seen = (alpha > 0.5) & (z > 0)
    inverse = np.where(seen, 1 / np.maximum(z, 1e-6), 0)
    low, high = np.percentile(inverse[seen], [1, 99]) if seen.any() else (0.0, 1.0)
    level = np.clip((inverse - low) / max(high - low, 1e-9), 0, 1)
    colors = colormaps["viridis"](level)[..., :3] * seen[..., None]
    return (colors * 255 + 0.5).astype(np.uint8)


def displacement_picture(field: RadianceField, camera: Camera, seen: RenderedView) -> np.ndarray:
    """Visualize the displacement |D| of each pixel's surface in magma, black for none: [h, w, 3] uint8.

    The scale ends at the 99th percentile over visible surfaces.
    """
    from scipy.ndimage import map_coordinates

    from stylerf.environment.matplotlib_defaults import colormaps

    if (grid := field.displacement) is None:
        raise InvalidValue("the field has no displacement to show")
    origins, directions = camera.rays()
    points = field.space.warp(origins + directions * seen.ray_distance.reshape(-1, 1))
    places = (points * (np.array(grid.shape[:3]) - 1)).T  # vertices span the cube, ends included
    moved = np.stack([map_coordinates(grid[..., axis], places, order=1) for axis in range(3)], -1)
    far = np.linalg.norm(moved, axis=1).reshape(seen.alpha.shape) * (seen.alpha > 0.5)
    most = max(float(np.percentile(far[seen.alpha > 0.5], 99)) if (seen.alpha > 0.5).any() else 0.0, 1e-9)
    return (colormaps["magma"](np.clip(far / most, 0, 1))[..., :3] * 255 + 0.5).astype(np.uint8)


def sheet_of(rows: list[list[np.ndarray]], beside: np.ndarray, gap: int = 6) -> np.ndarray:
    """Arrange images [h, w, 3] of one size in rows, right of `beside`, which spans all rows; 0..1, on white."""
    height, width = rows[0][0].shape[:2]
    tall = len(rows) * (height + gap) - gap
    wide = round(beside.shape[1] * tall / beside.shape[0])
    sheet = np.ones((tall, wide + len(rows[0]) * (width + gap), 3), np.float32)
    down = np.arange(tall) * beside.shape[0] // tall
    across = np.arange(wide) * beside.shape[1] // wide
    sheet[:, :wide] = beside[down[:, None], across[None, :], :3]
    for i, row in enumerate(rows):
        for j, picture in enumerate(row):
            top, left = i * (height + gap), wide + gap + j * (width + gap)
            sheet[top : top + height, left : left + width] = picture[..., :3]
    return sheet
