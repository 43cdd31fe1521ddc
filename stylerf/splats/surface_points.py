"""Points of a field's surfaces, drawn from the very samples that its pictures are made of."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter, sobel

from stylerf.fields.marching import ScratchArena
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.cameras import Camera
from stylerf.kernels.cpu.ray_samples import Rays
from stylerf.kernels.cpu.splat_placement import draw_samples
from stylerf.rendering.rays import Rendered, render_rays
from stylerf.rendering.view import RAYS_AT_ONCE

SURFACE_PIXELS = 4.0  # half the thickness of a surface


@dataclass(frozen=True)
class SurfacePoints:
    """Points that pictures show.

    Attributes:
        centers: [n, 3] float32, scene units.
        colors: [n, 3] float32 in 0..1, sRGB-encoded.
        opacities: [n] float32 in 0..1, of the surface that the point is part of.
        detail: [n] float32, contrast of the picture there, from 0.
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
    """Render a view, and draw one point of each ray from its weights: an opaque pixel gives one, an empty one none.

    Semi-transparent parts get their share, since a ray draws from all of its samples.

    Args:
        farthest: distance, scene units, that an opaque background is moved to; rays reach it at 1e3 or more.

    Returns:
        [h, w, 4] float32: premultiplied rgb, sRGB-encoded, and alpha; and the points.
    """
    count, arena = camera.width * camera.height, ScratchArena()
    out = np.empty((count, 4), np.float32)
    draws = generator.random(count, dtype=np.float32)
    parts: list[tuple[np.ndarray, ...]] = []
    for at in range(0, count, RAYS_AT_ONCE):
        pixels = np.arange(at, min(at + RAYS_AT_ONCE, count))
        pixels = pixels[np.argsort(pixels // camera.width % threads, kind="stable")]  # as render_view deals rows
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
    order = np.argsort(pixels)  # whatever the number of threads
    detail = _contrast(picture).reshape(-1)[pixels]
    found = [centers.astype(np.float32), colors.astype(np.float32), opacities, detail]
    return picture, SurfacePoints(*(values[order] for values in found))


def _colors(field: RadianceField, rendered: Rendered, hit: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Colors [n, 3] of the chosen samples; those without one take their ray's mean, as in compositing."""
    colors = rendered.colors[chosen]
    mean = rendered.unmapped[hit, :3] / np.maximum(rendered.unmapped[hit, 3:4], 1e-6)
    colors = np.where(colors[:, :1] < 0, mean, colors)
    if field.color_map is not None:
        colors = colors @ field.color_map.matrix.numpy().T + field.color_map.offset.numpy()
    return np.clip(colors, 0, 1)


def _contrast(picture: np.ndarray) -> np.ndarray:
    """Length of the gradient of a picture [h, w, 4], the largest within a pixel, [h, w]."""
    squares = sum(sobel(picture[..., channel], axis) ** 2 for channel in range(4) for axis in (0, 1))
    return maximum_filter(np.sqrt(squares), 3)
