"""What a view sees of a fixed density: the few samples that carry each pixel, packed, so that colors alone can learn.

While the density does not move, where rays end does not either: a stylization that visits a view thirty times need
march it once. Positions are kept in 16 bits an axis (1/128 of the finest cell of a 512^3 color grid).
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from stylerf.fields.radiance_field import RadianceField
from stylerf.fields.ray_samples import Rays
from stylerf.geometry.cameras import Camera
from stylerf.kernels.cpu.compositing import count_shown, pack_shown, significant, unpack

RAYS_AT_ONCE = 8192


@dataclass(frozen=True)
class PackedSurface:
    """offsets [pixels + 1] into x [n, 3] uint16 and weights [n] float32 (they sum to alpha per pixel); alpha [h, w]."""

    offsets: np.ndarray
    x: np.ndarray
    weights: np.ndarray
    alpha: np.ndarray

    @property
    def bytes(self) -> int:
        """Memory taken."""
        return self.offsets.nbytes + self.x.nbytes + self.weights.nbytes

    def samples(self, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """(starts, ends [pixels], x [n, 3] float32 in the cube, weights [n]) of chosen pixels (row-major indices)."""
        counts = self.offsets[pixels + 1] - self.offsets[pixels]
        ends = np.cumsum(counts)
        starts = ends - counts
        n = int(ends[-1]) if len(ends) else 0
        x, weights = np.empty((n, 3), np.float32), np.empty(n, np.float32)
        unpack(pixels, self.offsets, self.x, self.weights, starts, x, weights)
        return starts, ends, x, weights


def cells_of(surface: PackedSurface) -> float:
    """Cells a side of a grid over the cube whose cells are as wide as what one pixel of the view sees, nan if nothing.

    Per pixel, the nearer of its right and its lower neighbor's point on the surface (so that slanted surfaces count by
    their finer side); the median over pixels that are all but opaque. Points are means weighted as the colors are.
    """
    height, width = surface.alpha.shape
    starts, ends, x, weights = surface.samples(np.arange(height * width))
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
    """The median of cells_of over views, nan if none of them sees anything."""
    found = np.array([cells_of(surface) for surface in surfaces])
    return float(np.median(found[np.isfinite(found)])) if np.isfinite(found).any() else float("nan")


def surface_of(
    field: RadianceField, camera: Camera, share: float, chunks: int, opaque: float = 1e-3, stride: int = 1
) -> PackedSurface:
    """March one view. share: part of a ray's largest weight that a sample must have to be kept.

    stride: only each stride-th pixel of each stride-th row is walked; the surface is that of so much smaller a view.
    """
    pixels = np.arange(camera.height * camera.width).reshape(camera.height, camera.width)[::stride, ::stride]
    origins, directions = camera.rays(pixels.ravel())
    counts, parts_x, parts_w, alphas = [], [], [], []
    for at in range(0, len(origins), RAYS_AT_ONCE):
        part = slice(at, at + RAYS_AT_ONCE)
        samples = field.march(Rays.of(origins[part], directions[part], field.space.near), 512, opaque, chunks)
        starts, ends = samples.starts, samples.ends
        shown, count = np.empty_like(samples.weights), np.empty(len(ends), np.int64)
        significant(samples.weights, starts, ends, np.float32(share), chunks, shown)
        count_shown(shown, starts, ends, chunks, count)
        offsets = np.concatenate([[0], np.cumsum(count)])
        x, weights = np.empty((offsets[-1], 3), np.uint16), np.empty(offsets[-1], np.float32)
        pack_shown(shown, samples.x, samples.weights, starts, ends, offsets, chunks, x, weights)
        counts.append(count)
        parts_x.append(x)
        parts_w.append(weights)
        sums = np.concatenate([[0.0], np.cumsum(weights, dtype=np.float64)])
        alphas.append((sums[offsets[1:]] - sums[offsets[:-1]]).astype(np.float32))
    offsets = np.concatenate([[0], np.cumsum(np.concatenate(counts))]).astype(np.int64)
    alpha = np.clip(np.concatenate(alphas), 0, 1).reshape(pixels.shape)
    return PackedSurface(offsets, np.concatenate(parts_x), np.concatenate(parts_w), alpha)
