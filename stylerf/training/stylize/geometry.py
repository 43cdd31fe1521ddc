"""Rendering a scene during stylization: fixed surfaces that are only recolored, or rays through a deforming field."""

from abc import ABC, abstractmethod
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from torch import Tensor

from stylerf.fields.hash_grid import HashColor
from stylerf.fields.packed_surface import PackedSurface, surface_of
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.cameras import Camera
from stylerf.geometry.spherical_harmonics import harmonics
from stylerf.kernels.cpu.compositing import shade, shade_backward
from stylerf.kernels.cpu.ray_samples import Rays, ShadingPoints
from stylerf.rendering.rays import Rendered, backward, mapped, render_rays
from stylerf.training.common.adam import Adam, Optimizer
from stylerf.training.common.bounded_cache import BoundedCache
from stylerf.training.deform.deformer import Buffer, GridDeformer

RAYS_AT_ONCE = 8192
OPAQUE = 1e-2  # transmittance at which a ray terminates
Record = Any  # what paint() passes to learn() of the same geometry
Shaded = TypeVar("Shaded")  # rendered rays with everything that their gradients need


class Geometry(Protocol):
    """Renders pixels of views in the current colors and backpropagates their gradients."""

    def alpha(self, view: int) -> np.ndarray:
        """Return the view's alpha [h, w]."""

    def paint(self, view: int, pixels: np.ndarray) -> tuple[np.ndarray, Record]:
        """Return premultiplied rgb [n, 3] of pixels [n], and a record for learn()."""

    def learn(self, record: Record, gradients: np.ndarray, color_to: Any) -> None:
        """Add dL/d(color values) to an optimizer's buffer, from dL/d(rgb over the background) [n, 3]."""


class Surfaces(Geometry, Protocol):
    """A geometry that does not move. Only field.color is trained, which is view-independent."""

    field: RadianceField

    def new_adam(self, gradient_clip: float = 0.0) -> Optimizer:
        """Return an optimizer for field.color with zero moments."""

    def collect(self) -> None:
        """Copy learned values into field.color."""

    def surface(self, view: int) -> PackedSurface:
        """Return the samples of a view."""


class FixedGeometry:
    """Surfaces on the CPU: every view is marched once and its samples are cached, up to `memory` bytes.

    The last view's samples are always kept, since a step needs a view's surface several times.

    weight_threshold: fraction of a ray's largest weight below which a sample is left out.
    """

    def __init__(
        self,
        field: RadianceField,
        cameras: list[Camera],
        weight_threshold: float,
        threads: int,
        memory: float = 2048e6,
    ) -> None:
        self.field, self.cameras, self.weight_threshold, self.threads = field, cameras, weight_threshold, threads
        self._surfaces = BoundedCache(self._marched, lambda surface: surface.bytes, len(cameras), memory)
        self._last: tuple[int, PackedSurface] | None = None

    def new_adam(self, gradient_clip: float = 0.0) -> Adam:
        return Adam(self.field.color.values, self.field.color.groups(), self.threads, gradient_clip)

    def collect(self) -> None: ...  # field.color itself is trained

    def _marched(self, view: int) -> PackedSurface:
        return surface_of(self.field, self.cameras[view], self.weight_threshold, self.threads)

    def surface(self, view: int) -> PackedSurface:
        if self._last is not None and self._last[0] == view:
            return self._last[1]
        self._last = None  # before marching: never two surfaces outside the cache
        found = self._surfaces[view]
        self._last = view, found
        return found

    def alpha(self, view: int) -> np.ndarray:
        return self.surface(view).alpha

    def paint(self, view: int, pixels: np.ndarray) -> tuple[np.ndarray, tuple[ShadingPoints, np.ndarray]]:
        points = self.surface(view).samples(pixels)
        color = self.field.color
        if isinstance(color, HashColor):
            colors = color.colors(points, None, self.threads)
        else:  # the color beneath a region's own is view-dependent
            basis = harmonics(self.cameras[view].rays(pixels)[1], color.degree)
            colors = color.colors(points, basis, self.threads)
        out = np.empty((len(pixels), 3), np.float32)
        shade(points, colors, out)
        if self.field.color_map is not None:
            with_alpha = np.concatenate([out, self.alpha(view).reshape(-1, 1)[pixels]], 1)
            out = mapped(with_alpha, self.field.color_map)[:, :3]
        return out, (points, colors)

    def learn(self, record: tuple[ShadingPoints, np.ndarray], gradients: np.ndarray, color_to: np.ndarray) -> None:
        points, colors = record
        color_gradients = np.empty_like(points.x)
        if self.field.color_map is not None:
            gradients = gradients @ self.field.color_map.arrays()[0]
        # Weights are fixed, so alpha has no gradient; a sample's color gets its weight times its ray's gradient.
        shade_backward(points, gradients, color_gradients)
        self.field.color.backward(points, None, colors, color_gradients, color_to)


class RayGeometry(ABC, Generic[Shaded, Buffer]):
    """Rays through a deforming field, marched on every use, which train its colors and its deformation.

    weight_threshold: fraction of a ray's largest weight below which a sample is not colored. behind: color [3] behind
    the field, revealed by a moving silhouette; unused if the background is opaque. fixed: the undeformed field, which
    provides the alpha of views that have not been rendered yet.
    """

    rays_at_once = RAYS_AT_ONCE

    def __init__(
        self,
        field: RadianceField,
        cameras: list[Camera],
        weight_threshold: float,
        threads: int,
        behind: np.ndarray,
        deformer: GridDeformer[Buffer],
        fixed: Surfaces,
    ) -> None:
        self.field, self.cameras, self.weight_threshold, self.threads = field, cameras, weight_threshold, threads
        self.behind, self.fixed = behind, fixed
        self.deformer: GridDeformer[Buffer] = deformer
        self.alphas: dict[int, np.ndarray] = {}

    def alpha(self, view: int) -> np.ndarray:
        """Return the view's alpha [h, w], each pixel as last rendered."""
        if view not in self.alphas:
            self.alphas[view] = self.fixed.alpha(view).ravel().copy()
        return self.alphas[view].reshape(self.cameras[view].height, self.cameras[view].width)

    def paint(self, view: int, pixels: np.ndarray) -> tuple[np.ndarray, list[tuple[slice, Shaded]]]:
        camera, alphas = self.cameras[view], self.alpha(view).reshape(-1)
        rgb, record = np.empty((len(pixels), 3), np.float32), list[tuple[slice, Shaded]]()
        for at in range(0, len(pixels), self.rays_at_once):
            part = slice(at, min(at + self.rays_at_once, len(pixels)))
            chosen = pixels[part]
            out, rendered = self._rendered(camera, chosen)
            rgb[part] = out[:, :3]
            # In place, as a view into self.alphas: unselected pixels keep the alpha of their last render.
            alphas[chosen] = np.clip(out[:, 3], 0, 1)
            record.append((part, rendered))
        return rgb, record

    def learn(self, record: list[tuple[slice, Shaded]], gradients: np.ndarray, color_to: Buffer) -> None:
        """Add dL/d(color values), and dL/dD to the deformer's gradients, from dL/d(rgb over `behind`) [n, 3]."""
        for part, rendered in record:
            to = np.zeros((len(gradients[part]), 5), np.float32)
            to[:, :3] = gradients[part]
            if not self.field.opaque_background:
                # The image is rgb + (1 - alpha) behind: a moving silhouette learns from what it uncovers.
                to[:, 3] = -gradients[part] @ self.behind
            self._backward(rendered, to, color_to)

    @abstractmethod
    def _rendered(self, camera: Camera, pixels: np.ndarray) -> tuple[np.ndarray, Shaded]:
        """Return rendered pixels [n, 5] and what _backward() needs."""

    @abstractmethod
    def _backward(self, rendered: Shaded, gradients: np.ndarray, color_to: Buffer) -> None:
        """Add the gradients of color values and grid, from dL/d(pixels) [n, 5]."""


class MovingGeometry(RayGeometry[Rendered, np.ndarray]):
    """Rays on the CPU."""

    def _rendered(self, camera: Camera, pixels: np.ndarray) -> tuple[np.ndarray, Rendered]:
        rays = Rays.of(*camera.rays(pixels), self.field.space.near)
        rendered = render_rays(
            self.field, rays, threads=self.threads, min_transmittance=OPAQUE, weight_threshold=self.weight_threshold
        )
        return rendered.out, rendered

    def _backward(self, rendered: Rendered, gradients: np.ndarray, color_to: np.ndarray) -> None:
        backward(self.field, rendered, gradients, None, color_to, self.deformer.gradients)


AnyRayGeometry = MovingGeometry | RayGeometry[Any, Tensor]
