"""The visible surface of a fixed density: the few samples behind each pixel, packed, for training colors only.

With a fixed density, ray samples never change: a stylization that visits a view thirty times marches it once
(decision 0005). Positions take 16 bits per axis, 1/128 of the finest cell of a 512^3 color grid.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from stylerf.fields.marching import SAMPLES_PER_RAY
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.cameras import Camera
from stylerf.kernels.cpu.color_heads import count_marked
from stylerf.kernels.cpu.compositing import pack_visible, unpack, visible_weights
from stylerf.kernels.cpu.ray_samples import Rays, ShadingPoints

RAYS_AT_ONCE = 8192


@dataclass(frozen=True)
class PackedSurface:
    """The samples of one view.

    Attributes:
        offsets: [pixels + 1] int64, index of each pixel's first sample.
        x: [n, 3] uint16, position in the unit cube times 65535.
        weights: [n] float32, scaled to add up to each pixel's alpha.
        alpha: [h, w], 0..1.
    """

    offsets: np.ndarray
    x: np.ndarray
    weights: np.ndarray
    alpha: np.ndarray

    @property
    def bytes(self) -> int:
        """Memory size in bytes."""
        return self.offsets.nbytes + self.x.nbytes + self.weights.nbytes

    def samples(self, pixels: np.ndarray) -> ShadingPoints:
        """Return the samples of the given pixels (row-major indices, [rays])."""
        counts = self.offsets[pixels + 1] - self.offsets[pixels]
        ends = np.cumsum(counts)
        starts = ends - counts
        n = int(ends[-1]) if len(ends) else 0
        x, weights = np.empty((n, 3), np.float32), np.empty(n, np.float32)
        unpack(pixels, self.offsets, self.x, self.weights, starts, x, weights)
        return ShadingPoints(starts, ends, x, weights)


def cells_of(surface: PackedSurface) -> float:
    """Return the resolution of a grid over the cube whose cells are as wide as the view's pixels; nan if it is empty.

    The pixel width is the median, over nearly opaque pixels, of the distance to the nearer of the right and lower
    neighbors' surface points (slanted surfaces count by their finer side). A surface point is the weighted mean of the
    pixel's samples.
    """
    height, width = surface.alpha.shape
    starts, ends, x, weights = surface.samples(np.arange(height * width))
    # float64, because differences of cumulative sums over the whole view would cancel in float32.
    sums = np.zeros((len(x) + 1, 3))
    np.cumsum(x * weights[:, None], axis=0, dtype=np.float64, out=sums[1:])
    alpha = surface.alpha[..., None]
    points = (sums[ends] - sums[starts]).reshape(height, width, 3) / np.maximum(alpha, 1e-6)
    points = np.where(alpha > 0.9, points, np.nan)
    here = points[:-1, :-1]
    apart = np.minimum(np.linalg.norm(points[:-1, 1:] - here, axis=-1), np.linalg.norm(points[1:, :-1] - here, axis=-1))
    apart = apart[np.isfinite(apart) & (apart > 0)]
    return float(1 / np.median(apart)) if len(apart) else float("nan")


def pixel_cells(surfaces: Iterable[PackedSurface]) -> float:
    """Return the median of cells_of() over views; nan if all of them are empty."""
    found = np.array([cells_of(surface) for surface in surfaces])
    return float(np.median(found[np.isfinite(found)])) if np.isfinite(found).any() else float("nan")


def surface_of(
    field: RadianceField,
    camera: Camera,
    weight_threshold: float,
    threads: int,
    min_transmittance: float = 1e-3,
    stride: int = 1,
) -> PackedSurface:
    """March one view and keep its visible samples.

    Args:
        weight_threshold: fraction of its ray's largest weight that a sample needs to be kept.
        stride: march only every stride-th pixel along both axes; the surface is that of the smaller view.
    """
    pixels = np.arange(camera.height * camera.width).reshape(camera.height, camera.width)[::stride, ::stride]
    origins, directions = camera.rays(pixels.ravel())
    counts, parts_x, parts_weights, alphas = [], [], [], []
    for at in range(0, len(origins), RAYS_AT_ONCE):
        part = slice(at, at + RAYS_AT_ONCE)
        rays = Rays.of(origins[part], directions[part], field.space.near)
        samples = field.march(rays, SAMPLES_PER_RAY, min_transmittance, threads)
        visible, count = np.empty_like(samples.weights), np.empty(len(samples.ends), np.int64)
        visible_weights(samples, np.float32(weight_threshold), threads, visible)
        count_marked(visible.reshape(-1, 1), np.float32(0), samples.starts, samples.ends, threads, count)
        offsets = np.concatenate([[0], np.cumsum(count)])
        x, weights = np.empty((offsets[-1], 3), np.uint16), np.empty(offsets[-1], np.float32)
        pack_visible(visible, samples, offsets, threads, x, weights)
        counts.append(count)
        parts_x.append(x)
        parts_weights.append(weights)
        sums = np.concatenate([[0.0], np.cumsum(weights, dtype=np.float64)])
        alphas.append((sums[offsets[1:]] - sums[offsets[:-1]]).astype(np.float32))
    offsets = np.concatenate([[0], np.cumsum(np.concatenate(counts))]).astype(np.int64)
    alpha = np.clip(np.concatenate(alphas), 0, 1).reshape(pixels.shape)
    return PackedSurface(offsets, np.concatenate(parts_x), np.concatenate(parts_weights), alpha)
