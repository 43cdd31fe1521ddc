"""Which surface points cameras see, and how directly."""

from dataclasses import dataclass

import numpy as np

from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.cameras import Camera
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.rendering.view import render_view

PIXELS = 20_000  # of a view's depth map
HALF_SEEN = 0.5  # minimum alpha for a pixel to show a surface
GRAZING = 0.05  # minimum cosine between a normal and the direction to a camera that sees the point


@dataclass(frozen=True, eq=False)
class DepthView:
    """A camera and its depth map: z [h, w], planar depth of the visible surface, scene units; 0 where there is none."""

    camera: Camera
    z: np.ndarray

    @staticmethod
    def of(field: RadianceField, camera: Camera, threads: int) -> "DepthView":
        """Render the depth of a view, at about PIXELS pixels."""
        from scipy.ndimage import maximum_filter

        small = camera.scaled(min(1.0, (PIXELS / (camera.width * camera.height)) ** 0.5))
        seen = render_view(field, small, threads=threads)
        # The maximum over a pixel's neighbors: a point between two pixel centers may be behind either.
        return DepthView(small, maximum_filter(np.where(seen.alpha > HALF_SEEN, seen.z, 0), 3))

    def facing(self, points: np.ndarray, normals: np.ndarray, space: SpaceWarp, tolerance: float) -> np.ndarray:
        """Return, for points [n, 3], the cosine [n] between normal and direction to the camera; 0 where unseen.

        Args:
            normals: [n, 3], unit length.
            tolerance: cube units that a point may be behind the visible surface.
        """
        towards = self.camera.center - points
        cosines = (towards * normals).sum(1) / np.maximum(np.linalg.norm(towards, axis=1), 1e-12)
        pixels, depth = self.camera.project(points)
        column, row = np.floor(np.clip(pixels, -1, 1e6)).astype(np.int64).T
        inside = (column >= 0) & (column < self.camera.width) & (row >= 0) & (row < self.camera.height)
        ahead = np.flatnonzero(inside & (depth > 0) & (cosines > GRAZING))
        surface = self.z[row[ahead], column[ahead]]
        hits = self.camera.center - towards[ahead] * (surface / depth[ahead])[:, None]
        near = np.abs(space.warp(hits) - space.warp(points[ahead])).max(1) <= tolerance
        seen = ahead[(surface > 0) & ((depth[ahead] <= surface) | near)]
        out = np.zeros(len(points))
        out[seen] = cosines[seen]
        return out
