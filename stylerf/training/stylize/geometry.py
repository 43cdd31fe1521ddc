"""How a stylization sees its scene: fixed surfaces that are colored, or rays walked anew through a deforming field."""

import numpy as np

from stylerf.fields.hash_color import HashColor
from stylerf.fields.packed_surface import PackedSurface, surface_of
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.cameras import Camera
from stylerf.geometry.spherical_harmonics import harmonics
from stylerf.kernels.cpu.compositing import shade, shade_backward
from stylerf.kernels.cpu.ray_samples import Rays
from stylerf.rendering.rays import Rendered, backward, render_rays
from stylerf.training.common.bounded_cache import BoundedCache
from stylerf.training.deform.deformer import Deformer

RAYS_AT_ONCE = 8192
OPAQUE = 1e-2  # transmittance at which a walked ray ends


class FixedGeometry:
    """Colors on surfaces that do not move: every view is marched once and its samples are kept, up to `memory` bytes.

    share: part of a ray's largest weight that a sample needs to take part. What learns is the same from everywhere.
    """

    def __init__(
        self, field: RadianceField, cameras: list[Camera], share: float, chunks: int, memory: float = 2048e6
    ) -> None:
        self.field, self.cameras, self.share, self.chunks = field, cameras, share, chunks
        self._surfaces = BoundedCache(self._marched, lambda surface: surface.bytes, len(cameras), memory)

    def _marched(self, view: int) -> PackedSurface:
        return surface_of(self.field, self.cameras[view], self.share, self.chunks)

    def surface(self, view: int) -> PackedSurface:
        """The samples of a view."""
        return self._surfaces[view]

    def alpha(self, view: int) -> np.ndarray:
        """[h, w]."""
        return self.surface(view).alpha

    def paint(self, view: int, pixels: np.ndarray) -> tuple[np.ndarray, tuple]:
        """Premultiplied rgb [n, 3] of pixels, and what learn() needs."""
        points = self.surface(view).samples(pixels)
        color, basis = self.field.color, None
        if not isinstance(color, HashColor):  # what lies under a part's own colors is seen from somewhere
            basis = harmonics(self.cameras[view].rays(pixels)[1], color.degree)
        colors = color.colors(points, basis, self.chunks)
        out = np.empty((len(pixels), 3), np.float32)
        shade(points, colors, out)
        return out, (points, colors)

    def learn(self, kept: tuple, gradients: np.ndarray, color_to: np.ndarray) -> None:
        """Add dL/d(color values), from dL/d(rgb) [n, 3], to the chunks' buffers."""
        points, colors = kept
        color_gradients = np.empty_like(points.x)
        shade_backward(points, gradients, color_gradients)
        self.field.color.backward(points, None, colors, color_gradients, color_to)


class MovingGeometry:
    """Rays walked anew through a field that deforms, which learn its colors and its deformation.

    share: part of a ray's largest weight that a sample needs to be colored. background: level of gray behind the
    field, which shows where a moving silhouette lets it; not used for a closed scene. still: the same field before
    anything moved; a view that was not painted yet has the alpha that it has there.
    """

    rays_at_once = RAYS_AT_ONCE

    def __init__(
        self,
        field: RadianceField,
        cameras: list[Camera],
        share: float,
        chunks: int,
        background: float,
        deformer: Deformer,
        still: FixedGeometry,
    ) -> None:
        self.field, self.cameras, self.share, self.chunks = field, cameras, share, chunks
        self.background, self.deformer, self.still = np.float32(background), deformer, still
        self.alphas: dict[int, np.ndarray] = {}

    def alpha(self, view: int) -> np.ndarray:
        """[h, w], each pixel as it was last painted."""
        if view not in self.alphas:
            self.alphas[view] = self.still.alpha(view).ravel().copy()
        return self.alphas[view].reshape(self.cameras[view].height, self.cameras[view].width)

    def paint(self, view: int, pixels: np.ndarray) -> tuple[np.ndarray, list[tuple[slice, Rendered]]]:
        """Premultiplied rgb [n, 3] of pixels, and what learn() needs."""
        camera, alphas = self.cameras[view], self.alpha(view).reshape(-1)
        rgb, kept = np.empty((len(pixels), 3), np.float32), []
        for at in range(0, len(pixels), self.rays_at_once):
            part = slice(at, min(at + self.rays_at_once, len(pixels)))
            chosen = pixels[part]
            out, rendered = self._rendered(camera, chosen)
            rgb[part] = out[:, :3]
            alphas[chosen] = np.clip(out[:, 3], 0, 1)
            kept.append((part, rendered))
        return rgb, kept

    def _rendered(self, camera: Camera, pixels: np.ndarray) -> tuple[np.ndarray, Rendered]:
        """[n, 5] of pixels [n] of a view, and what _backward needs."""
        rays = Rays.of(*camera.rays(pixels), self.field.space.near)
        rendered = render_rays(
            self.field, rays, threads=self.chunks, min_transmittance=OPAQUE, weight_threshold=self.share
        )
        return rendered.out, rendered

    def learn(self, kept: list[tuple[slice, Rendered]], gradients: np.ndarray, color_to: np.ndarray) -> None:
        """Add dL/d(color values) and dL/dD, from dL/d(rgb over the background) [n, 3], to the chunks' buffers."""
        for part, rendered in kept:
            to = np.zeros((len(rendered.out), 5), np.float32)
            to[:, :3] = gradients[part]
            if not self.field.opaque_background:
                to[:, 3] = -self.background * gradients[part].sum(1)
            self._backward(rendered, to, color_to)

    def _backward(self, rendered: Rendered, gradients: np.ndarray, color_to: np.ndarray) -> None:
        """Add what dL/d(pixels) [n, 5] teaches."""
        backward(self.field, rendered, gradients, None, color_to, self.deformer.gradients)
