"""Colors of a region's own, over a field's: what lies outside the region keeps its color, bit for bit.

Planes and lines (vm) and hash tables are shared by places far apart, so that teaching a part of a scene new colors
tints others; here only the region's samples are asked, and only its own numbers learn.
"""

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.fields.hash_color import HashColor
from stylerf.fields.ray_samples import Samples
from stylerf.kernels.cpu import region_color as kernels


class RegionColor:
    """Color sigmoid(logit(base) + f) in marked cells, f the logits of `own` (a hash grid over the cells' box); base

    elsewhere. values: own's, the only ones that learn; f = 0 is the base itself. marked: [s, s, s] bool, cells of the
    cube.
    """

    kind = "patch"

    def __init__(self, base, own: HashColor, marked: np.ndarray) -> None:
        s = marked.shape[0]
        if marked.shape != (s, s, s) or marked.dtype != bool or not marked.any():
            raise InvalidValue(f"patch: marked cells [s, s, s] of bool were expected, some of them set; {marked.shape}")
        self.base, self.own, self.marked = base, own, np.ascontiguousarray(marked)
        self._flat, self.cells = self.marked.reshape(-1), s
        self.low, self.side = box_of(self.marked)

    @classmethod
    def create(cls, base, marked: np.ndarray, pixel_cells: float, table: int = 1 << 15, levels: int = 8):
        """The base itself, ready to learn. pixel_cells: cells a side of the cube as wide as what a pixel sees."""
        side = box_of(marked)[1]
        finest = int(np.clip(round(pixel_cells * side), 16, 1024)) if np.isfinite(pixel_cells) else 64
        own = HashColor.create(np.random.default_rng(0), levels, min(8, finest), finest, table)
        own.values[:] = 0
        return cls(base, own, marked)

    @property
    def values(self) -> np.ndarray:
        """What learns."""
        return self.own.values

    @property
    def degree(self) -> int:
        """Of the spherical harmonics that the base asks for."""
        return getattr(self.base, "degree", 0)

    def groups(self) -> list[tuple[int, int, float]]:
        """(begin, end, learning-rate factor) of parts of `values`."""
        return self.own.groups()

    def colors(self, x, basis, starts, ends, weights, least, chunks) -> np.ndarray:
        """[n, 3] colors in 0..1 of samples with weight > least; others have -1 in the first channel."""
        out = self.base.colors(x, basis, starts, ends, weights, least, chunks)
        within = np.empty_like(weights)
        own_x = self._within(x, weights, starts, ends, chunks, within)
        own = self.own.colors(own_x, None, starts, ends, within, least, chunks)
        kernels.add_logits(own, starts, ends, chunks, out)
        return out

    def backward(self, x, basis, starts, ends, colors, color_gradients, to: np.ndarray) -> None:
        """Add dL/d(values) to the chunks' buffers `to` [chunks, len(values)].

        The slope of a sigmoid is told by its value, whatever was added within.
        """
        inside, own_x = self._colored_inside(x, starts, ends, colors, len(to))
        self.own.backward(own_x, None, starts, ends, inside, color_gradients, to)

    def add_position_gradients(
        self, samples: Samples, basis, colors: np.ndarray, color_gradients: np.ndarray, out, chunks: int
    ) -> None:
        """Add dL/dx to out [n, 3], x the samples' positions in the cube."""
        self.base.add_position_gradients(samples, basis, colors, color_gradients, out, chunks)
        starts, ends = samples.starts, samples.ends
        inside, own_x = self._colored_inside(samples.x, starts, ends, colors, chunks)
        found = np.zeros(samples.x.shape, np.float32)
        own = Samples(**{**vars(samples), "x": own_x})
        self.own.add_position_gradients(own, None, inside, color_gradients, found, chunks)
        kernels.add_scaled(found, np.float32(1 / self.side), starts, ends, chunks, out)

    def smooth(self, strength: float, to: np.ndarray) -> None:
        """Add the gradient that draws the patch to the base to buffer `to` [len(values)]."""
        self.own.smooth(strength, to)

    def _within(self, x, weights, starts, ends, chunks, within) -> np.ndarray:
        """Positions in the box, and in `within` the weights of samples in marked cells, 0 for others."""
        own_x = np.empty_like(x)
        low, scale = self.low.astype(np.float32), np.float32(1 / self.side)
        kernels.restrict(self._flat, self.cells, low, scale, x, weights, starts, ends, chunks, own_x, within)
        return own_x

    def _colored_inside(self, x, starts, ends, colors, chunks) -> tuple[np.ndarray, np.ndarray]:
        """(colors, with -1 in the first channel where a sample is not inside or has none; positions in the box)."""
        inside, own_x = np.empty_like(colors), np.empty_like(x)
        low, scale = self.low.astype(np.float32), np.float32(1 / self.side)
        kernels.restrict_colored(self._flat, self.cells, low, scale, x, colors, starts, ends, chunks, own_x, inside)
        return inside, own_x


def box_of(marked: np.ndarray) -> tuple[np.ndarray, float]:
    """(lowest corner [3], side) of the smallest cube, in cube units, around marked cells [s, s, s]."""
    where = np.argwhere(marked)
    low, high = where.min(0) / marked.shape[0], (where.max(0) + 1) / marked.shape[0]
    return low, float((high - low).max())
