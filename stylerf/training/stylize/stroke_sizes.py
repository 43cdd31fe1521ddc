"""Stroke sizes that follow perspective: small far away, large nearby (as in Geometry Transfer, Jung et al. 2024).

There are four sizes, each with its own features of the style image. Every position of a view is matched once.
"""

import numpy as np

from stylerf.geometry.cameras import Camera, evenly_spaced
from stylerf.rendering.ray_registration import points_of
from stylerf.training.common.bounded_cache import BoundedCache
from stylerf.training.stylize.scene import StyledScene
from stylerf.training.stylize.settings import ImageStyleSettings

FACTORS = (2.0, 1.26, 0.79, 0.5)  # of the stroke at the scene's median depth; equal ratios
MEDIAN_OF = 8  # views


def stroke_sizes(stroke: float, by_depth: bool) -> tuple[float, ...]:
    """Return the stroke sizes for which features of the style image are needed."""
    return tuple(factor * stroke for factor in FACTORS) if by_depth else (stroke,)


def factors_at(depth: np.ndarray, median: float) -> np.ndarray:
    """Return the index [h, w] uint8 into FACTORS, nearest in ratio to median / depth; depth [h, w] > 0, inf: empty.

    Halving a depth doubles the factor, which is clamped beyond twice and below half the median depth.
    """
    wanted = np.log(np.clip(median / depth, FACTORS[-1], FACTORS[0]))
    return np.abs(wanted[..., None] - np.log(FACTORS)).argmin(-1).astype(np.uint8)


class StrokesByDepth:
    """For each view of a scene, the index into FACTORS per pixel. memory: maximum size of the cache, bytes."""

    def __init__(self, scene: StyledScene[ImageStyleSettings], memory: float) -> None:
        self.scene = scene
        chosen = [scene.shown[at] for at in evenly_spaced(len(scene.shown), MEDIAN_OF)]
        depths = np.concatenate([depth[np.isfinite(depth)] for depth in map(self._depth, chosen)])
        self.median = float(np.median(depths)) if len(depths) else 1.0
        self._places = BoundedCache(self._made, lambda made: made.nbytes, len(scene.cameras), memory)

    def __getitem__(self, view: int) -> np.ndarray:
        """Return the view's indices [h, w] uint8."""
        return self._places[view]

    def _made(self, view: int) -> np.ndarray:
        return factors_at(self._depth(view), self.median)

    def _depth(self, view: int) -> np.ndarray:
        """Return a view's planar depth [h, w] before any deformation; inf where empty."""
        camera: Camera = self.scene.cameras[view]
        seen = points_of(self.scene.fixed.surface(view), camera, self.scene.field.space)
        depth = camera.project(seen.points)[1]
        return np.where(seen.there & (depth > 0), depth, np.inf).reshape(camera.height, camera.width)
