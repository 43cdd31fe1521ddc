"""Whole views of a field."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from stylerf.fields.marching import ScratchArena
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.cameras import Camera
from stylerf.kernels.cpu.ray_samples import Rays
from stylerf.rendering.rays import render_rays, with_surface_distance
from stylerf.rendering.region_alpha import alpha_inside

RAYS_AT_ONCE = 8192


@dataclass(frozen=True)
class RenderedView:
    """The images of one view.

    Attributes:
        rgb: [h, w, 3], sRGB-encoded, premultiplied (sum of w c, no background).
        alpha: [h, w], 0..1.
        ray_distance: [h, w], along the ray to the visible surface (decision 0032), scene units, 0 where alpha is 0.
        z: [h, w], the same along the viewing axis.
        masks: by region, [h, w], the part of alpha that lies in it, 0..alpha.
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
) -> RenderedView:
    """Render every pixel center of a camera.

    Args:
        field, camera: what is rendered, and from where.
        threads: threads of the kernels.
        min_transmittance: a ray ends once its transmittance falls below this.
        rays_at_once: bounds memory.
        regions: marked cells [s, s, s] bool by name; their masks come from the very samples of the picture.
        on_rays: called with the number of rays done after each batch.
    """
    count = camera.width * camera.height
    out = np.empty((count, 5), np.float32)
    inside = {name: np.empty(count, np.float32) for name in regions or {}}
    arena = ScratchArena()
    for at in range(0, count, rays_at_once):
        pixels = np.arange(at, min(at + rays_at_once, count))
        # Deal rows to the threads in turn: the upper half of a picture is often emptier than the lower.
        pixels = pixels[np.argsort(pixels // camera.width % threads, kind="stable")]
        rays = Rays.of(*camera.rays(pixels), field.space.near)
        rendered = render_rays(
            field,
            rays,
            threads=threads,
            min_transmittance=min_transmittance,
            weight_threshold=field.weight_threshold,
            arena=arena.reset(),
        )
        out[pixels] = with_surface_distance(rendered, threads)
        for name, mask in inside.items():
            mask[pixels] = alpha_inside(regions[name], rendered.samples, threads)
        on_rays(min(at + rays_at_once, count))
    return view_of(camera, out, inside)


def view_of(camera: Camera, out: np.ndarray, inside: Mapping[str, np.ndarray]) -> RenderedView:
    """Arrange rendered pixels as images.

    Args:
        out: [pixels, 5]: premultiplied rgb, alpha, surface distance.
        inside: by region, [pixels] part of alpha that lies in it.
    """
    out = out.reshape(camera.height, camera.width, 5)
    alpha = np.clip(out[..., 3], 0, 1)
    distance = np.where(alpha > 0, out[..., 4], 0)
    masks = {name: np.minimum(mask.reshape(alpha.shape), alpha) for name, mask in inside.items()}
    return RenderedView(out[..., :3], alpha, distance, distance * camera.ray_cosines(), masks)
