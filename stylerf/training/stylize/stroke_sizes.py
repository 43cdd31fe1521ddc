"""Strokes that are as large as things look: small far away, large nearby (as in Geometry Transfer, Jung et al. 2024).

Sizes come in four steps, each with its own features of the style image. Every position of a view is matched once.
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
    """Return the sizes of strokes that the style image's features are needed at."""
    return tuple(factor * stroke for factor in FACTORS) if by_depth else (stroke,)


def factors_at(depth: np.ndarray, median: float) -> np.ndarray:
    """Return the place in FACTORS nearest in ratio to median / depth; depth [h, w] > 0, inf for nothing: [h, w] uint8.

    Halving a depth doubles the factor; beyond twice and below half the median it stays.
    """
    wanted = np.log(np.clip(median / depth, FACTORS[-1], FACTORS[0]))
    return np.abs(wanted[..., None] - np.log(FACTORS)).argmin(-1).astype(np.uint8)


class StrokesByDepth:
    """For each view of a scene, which of FACTORS its pixels have. memory: bytes that may be kept."""

    def __init__(self, scene: StyledScene[ImageStyleSettings], memory: float) -> None:
        self.scene = scene
        chosen = [scene.shown[at] for at in evenly_spaced(len(scene.shown), MEDIAN_OF)]
        depths = np.concatenate([depth[np.isfinite(depth)] for depth in map(self._depth, chosen)])
        self.median = float(np.median(depths)) if len(depths) else 1.0
        self._places = BoundedCache(self._made, lambda made: made.nbytes, len(scene.cameras), memory)

    def __getitem__(self, view: int) -> np.ndarray:
        """[h, w] uint8."""
        return self._places[view]

    def _made(self, view: int) -> np.ndarray:
        return factors_at(self._depth(view), self.median)

    def _depth(self, view: int) -> np.ndarray:
        """Planar depth [h, w] of what the view shows of the scene before anything moved; inf where that is nothing."""
        camera: Camera = self.scene.cameras[view]
        seen = points_of(self.scene.fixed.surface(view), camera, self.scene.field.space)
        depth = camera.project(seen.points)[1]
        return np.where(seen.there & (depth > 0), depth, np.inf).reshape(camera.height, camera.width)
