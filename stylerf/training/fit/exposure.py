"""Estimate the exposure differences of photos, from surfaces that several of them see.

With auto exposure, a wall is bright in one photo and dark in another, and a field can only mix them or give each side
of the wall its own color. NeRF-W learns an appearance per photo (Martin-Brualla et al. 2021); here it is one number per
photo. Photos are compared with each other, never with the field, which has learned their differences by then; only its
depth is used, to find where a surface is seen again.
"""

from collections.abc import Callable

import numpy as np

from stylerf.srgb import LUMA, decoded
from stylerf.training.common.ray_dataset import RayDataset

POINTS = 16384  # surface points in all, at least MIN_POINTS per photo
MIN_POINTS = 64
OTHERS, TRIED = 3, 12  # photos compared per point, found among so many random ones
DARKEST, BRIGHTEST = 0.03, 0.97  # usable code values
CLIPPED = 250  # bytes from which a sensor may have been saturated
SOLID = 0.9  # alpha of a surface
APART = 0.03  # of its distance, how far a point may lie from the surface that another photo sees
ROUNDS = 20
FEWEST_PHOTOS = 12  # with fewer, depth is too unreliable; nothing is done unless requested
PLAINLY = 0.27  # stops, standard deviation, from which exposures clearly differ
# From origins and directions [n, 3] to premultiplied color, alpha and distance [n, 5].
Renderer = Callable[[np.ndarray, np.ndarray], np.ndarray]


class Exposures:
    """Judges the exposure of a dataset's photos at pixels chosen once."""

    def __init__(self, dataset: RayDataset, seed: int) -> None:
        self.dataset = dataset
        count = len(dataset.cameras)
        generator = np.random.default_rng([seed, 5])
        self.views = np.repeat(np.arange(count), max(MIN_POINTS, POINTS // count))
        self.pixels = (generator.random(len(self.views)) * dataset.sizes[self.views]).astype(np.int64)
        # Any view but the point's own.
        self.others = (self.views[:, None] + generator.integers(1, max(count, 2), (len(self.views), TRIED))) % count

    def judged(self, rendered: Renderer, stops: np.ndarray) -> np.ndarray:
        """Estimate by how many stops each photo is overexposed, [views], mean 0. stops: the present estimate."""
        points, luminance = self._surfaces(rendered, self.views, self.pixels)[:2]
        at, others, pixels = self._seen_again(points, np.isfinite(luminance))
        found, luminance_there, distance = self._surfaces(rendered, others, pixels)
        # A point is seen again if the other photo's own ray ends at the same place, not at an occluder in front of it.
        apart = np.linalg.norm(found - points[at], axis=1)
        same = np.isfinite(luminance_there) & (apart < APART * distance)
        beyond = np.log2(luminance[at[same]] / luminance_there[same])
        return balanced(len(stops), self.views[at[same]], others[same], beyond, stops)

    def _surfaces(
        self, rendered: Renderer, views: np.ndarray, pixels: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of pixels [n]: points in the world [n, 3], light that the photos show there, NaN where unusable [n],
        and the distance [n]."""
        origins, directions, colors = self.dataset.at(views, pixels)
        out = rendered(origins, directions)
        distance = out[:, 4]
        rgb = colors[:, :3]
        usable = (rgb > DARKEST) & (rgb < np.minimum(self.dataset.codes[views, CLIPPED], BRIGHTEST)[:, None])
        usable = usable.all(1) & (colors[:, 3] > SOLID) & (out[:, 3] > SOLID)
        luminance = np.where(usable, decoded(rgb.astype(np.float64)) @ LUMA, np.nan)
        return origins + directions * distance[:, None], luminance, distance

    def _seen_again(self, points: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(point, view, pixel) [m] of the first OTHERS photos that each known point falls into."""
        pixels = np.full(self.others.shape, -1)
        # Sorted by view, so that each camera projects its points in one call.
        by_view = np.argsort(self.others, axis=None, kind="stable")
        edges = np.searchsorted(self.others.reshape(-1)[by_view], np.arange(len(self.dataset.cameras) + 1))
        for camera, first, end in zip(self.dataset.cameras, edges[:-1], edges[1:], strict=True):
            at, place = np.divmod(by_view[first:end], TRIED)
            at, place = at[known[at]], place[known[at]]
            position, depth = camera.project(points[at])
            # Points behind a camera project anywhere, even to infinity, which has no int64.
            column, row = np.floor(np.clip(position, -1, 1e6)).astype(np.int64).T
            inside = (depth > 0) & (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
            pixels[at[inside], place[inside]] = (row * camera.width + column)[inside]
        seen = pixels >= 0
        at, place = np.nonzero(seen & (np.cumsum(seen, 1) <= OTHERS))
        return at, self.others[at, place], pixels[at, place]


def balanced(count: int, first: np.ndarray, second: np.ndarray, beyond: np.ndarray, now: np.ndarray) -> np.ndarray:
    """[count] stops, their mean 0: `now` and what differences `beyond` [n] of photos `first` to photos `second` add.

    Least absolute deviations, by weighted least squares repeated; a photo without data keeps its value.
    """
    change: np.ndarray = np.zeros(count)
    for _ in range(ROUNDS):
        # Weights 1/|residual| turn least squares into least absolute deviations; the floor (stops) bounds them at a
        # residual of 0. A common offset is free and a photo may have no data: the ridge keeps the system regular.
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
