"""Estimate exposure differences between photos from surfaces that several of them see.

With auto exposure, a wall is bright in one photo and dark in another, and a field can only average them or bake the
difference into the wall. NeRF-W learns an appearance per photo (Martin-Brualla et al. 2021); here it is one number per
photo. Photos are compared with each other, never with the field, which has learned their differences by then; the field
only provides depth, to find where a surface is seen again.
"""

from collections.abc import Callable

import numpy as np

from stylerf.srgb import LUMA, decoded
from stylerf.training.common.ray_dataset import RayDataset

POINTS = 16384  # surface points in all, at least MIN_POINTS per photo
MIN_POINTS = 64
OTHERS, TRIED = 3, 12  # photos compared per point, out of this many random candidates
DARKEST, BRIGHTEST = 0.03, 0.97  # usable code values
CLIPPED = 250  # byte values from which the sensor may have been saturated
SOLID = 0.9  # minimum alpha of a surface
APART = 0.03  # tolerance between a point and the surface that another photo sees, relative to the distance
ROUNDS = 20
FEWEST_PHOTOS = 12  # with fewer, depth is too unreliable, so nothing is done unless requested
# Exposures clearly differ if their standard deviation, in stops, is at least PLAINLY and correcting them leaves at most
# UNEXPLAINED of the median difference between photos: wrong depth also makes photos differ (decision 0074).
PLAINLY, UNEXPLAINED = 0.27, 0.7
# Maps origins and directions [n, 3] to premultiplied color, alpha and distance [n, 5].
Renderer = Callable[[np.ndarray, np.ndarray], np.ndarray]


class Exposures:
    """Estimates the exposure of a dataset's photos at pixels that are chosen once."""

    def __init__(self, dataset: RayDataset, seed: int) -> None:
        self.dataset = dataset
        count = len(dataset.cameras)
        generator = np.random.default_rng([seed, 5])
        self.views = np.repeat(np.arange(count), max(MIN_POINTS, POINTS // count))
        self.pixels = (generator.random(len(self.views)) * dataset.sizes[self.views]).astype(np.int64)
        # Any view but the point's own.
        self.others = (self.views[:, None] + generator.integers(1, max(count, 2), (len(self.views), TRIED))) % count

    def judged(self, rendered: Renderer, stops: np.ndarray) -> tuple[np.ndarray, float]:
        """Estimate by how many stops each photo is overexposed. stops: the current estimate.

        Returns:
            Stops [views], mean 0, and the fraction of the median difference between photos that correcting them leaves.
        """
        points, luminance = self._surfaces(rendered, self.views, self.pixels)[:2]
        at, others, pixels = self._seen_again(points, np.isfinite(luminance))
        found, luminance_there, distance = self._surfaces(rendered, others, pixels)
        # A point is seen again if the other photo's ray ends at the same point, not at an occluder in front of it.
        apart = np.linalg.norm(found - points[at], axis=1)
        same = np.isfinite(luminance_there) & (apart < APART * distance)
        first, second = self.views[at[same]], others[same]
        beyond = np.log2(luminance[at[same]] / luminance_there[same])
        estimate = balanced(len(stops), first, second, beyond, stops)
        change = estimate - stops
        left = np.abs(beyond - (change[first] - change[second]))
        return estimate, float(np.median(left) / max(np.median(np.abs(beyond)), 1e-6)) if len(left) else 1.0

    def _surfaces(
        self, rendered: Renderer, views: np.ndarray, pixels: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return, for pixels [n], world-space points [n, 3], luminance in the photos [n] (linear; NaN where unusable)
        and distances [n]."""
        origins, directions, colors = self.dataset.at(views, pixels)
        out = rendered(origins, directions)
        distance = out[:, 4]
        rgb = colors[:, :3]
        usable = (rgb > DARKEST) & (rgb < np.minimum(self.dataset.codes[views, CLIPPED], BRIGHTEST)[:, None])
        usable = usable.all(1) & (colors[:, 3] > SOLID) & (out[:, 3] > SOLID)
        luminance = np.where(usable, decoded(rgb.astype(np.float64)) @ LUMA, np.nan)
        return origins + directions * distance[:, None], luminance, distance

    def _seen_again(self, points: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return (point, view, pixel) [m] for the first OTHERS photos that each known point projects into."""
        pixels = np.full(self.others.shape, -1)
        # Sorted by view, so that each camera projects its points in one call.
        by_view = np.argsort(self.others, axis=None, kind="stable")
        edges = np.searchsorted(self.others.reshape(-1)[by_view], np.arange(len(self.dataset.cameras) + 1))
        for camera, first, end in zip(self.dataset.cameras, edges[:-1], edges[1:], strict=True):
            at, place = np.divmod(by_view[first:end], TRIED)
            at, place = at[known[at]], place[known[at]]
            position, depth = camera.project(points[at])
            # Points behind a camera may project anywhere, even to infinity, which int64 cannot represent.
            column, row = np.floor(np.clip(position, -1, 1e6)).astype(np.int64).T
            inside = (depth > 0) & (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
            pixels[at[inside], place[inside]] = (row * camera.width + column)[inside]
        seen = pixels >= 0
        at, place = np.nonzero(seen & (np.cumsum(seen, 1) <= OTHERS))
        return at, self.others[at, place], pixels[at, place]


def balanced(count: int, first: np.ndarray, second: np.ndarray, beyond: np.ndarray, now: np.ndarray) -> np.ndarray:
    """Return stops [count], mean 0: `now`, corrected by the differences `beyond` [n] from photos `first` to `second`.

    Least absolute deviations by iteratively reweighted least squares; a photo without data keeps its value.
    """
    change: np.ndarray = np.zeros(count)
    for _ in range(ROUNDS):
        # Weights 1/|residual| turn least squares into least absolute deviations; the floor (stops) bounds them near a
        # zero residual. A common offset is free and a photo may have no data, so the ridge keeps the system regular.
        weight = 1 / np.maximum(np.abs(change[first] - change[second] - beyond), 0.02)
        matrix, sums = 1e-3 * np.eye(count), np.zeros(count)
        np.add.at(matrix, (first, first), weight)
        np.add.at(matrix, (second, second), weight)
        np.add.at(matrix, (first, second), -weight)
        np.add.at(matrix, (second, first), -weight)
        np.add.at(sums, first, weight * beyond)
        np.add.at(sums, second, -weight * beyond)
        change = np.linalg.solve(matrix, sums)
    return now + change - (now + change).mean()
