"""Whole views of a field."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from stylerf.fields.radiance_field import RadianceField
from stylerf.fields.ray_samples import Rays
from stylerf.fields.scratch_arena import ScratchArena
from stylerf.geometry.cameras import Camera
from stylerf.rendering.rays import render_rays, seen
from stylerf.rendering.region_alpha import alpha_inside

RAYS_AT_ONCE = 8192


@dataclass(frozen=True)
class RenderedView:
    """rgb [h, w, 3]: sRGB-encoded, premultiplied (sum of w c, no background). alpha [h, w].

    ray_distance [h, w]: along the ray to the surface that it shows (decision 0032), scene units, 0 where alpha is 0;
    z [h, w]: the same along the viewing axis. masks: by region, [h, w] the part of alpha that lies in it, 0..alpha.
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
    chunks: int,
    opaque: float = 1e-3,
    rays_at_once: int = RAYS_AT_ONCE,
    regions: Mapping[str, np.ndarray] | None = None,
    on_rays: Callable[[int], None] = lambda done: None,
) -> RenderedView:
    """Render every pixel center of a camera; memory is bounded by rays_at_once. on_rays: told after each part.

    regions: marked cells [s, s, s] by name, whose share of each ray comes from the very samples of the picture.
    """
    count = camera.width * camera.height
    out = np.empty((count, 5), np.float32)
    inside = {name: np.empty(count, np.float32) for name in regions or {}}
    memory = ScratchArena()
    for at in range(0, count, rays_at_once):
        pixels = np.arange(at, min(at + rays_at_once, count))
        # Rows by turns to each thread: the upper half of a picture is often emptier than the lower.
        pixels = pixels[np.argsort(pixels // camera.width % chunks, kind="stable")]
        with memory.round():
            rays = Rays.of(*camera.rays(pixels), field.space.near)
            rendered = render_rays(field, rays, chunks=chunks, opaque=opaque, share=field.share)
            out[pixels] = seen(rendered, chunks)
            for name, mask in inside.items():
                mask[pixels] = alpha_inside(regions[name], rendered.samples, chunks)
        on_rays(min(at + rays_at_once, count))
    out = out.reshape(camera.height, camera.width, 5)
    alpha = np.clip(out[..., 3], 0, 1)
    distance = np.where(alpha > 0, out[..., 4], 0)
    masks = {name: np.minimum(mask.reshape(alpha.shape), alpha) for name, mask in inside.items()}
    return RenderedView(out[..., :3], alpha, distance, distance * camera.ray_cosines(), masks)
