"""Colors of a region's own, over a field's: what lies outside the region keeps its color, bit for bit.

Planes and lines (vm) and hash tables are shared by places far apart, so that teaching a part of a scene new colors
tints others; here only the region's samples are asked, and only its own numbers learn.
"""

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.fields.hash_color import HashColor
from stylerf.fields.scratch_arena import ScratchArena
from stylerf.kernels.cpu import region_color as kernels
from stylerf.kernels.cpu.ray_samples import ShadingPoints


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

    def colors(
        self, points: ShadingPoints, basis: np.ndarray, threads: int, arena: ScratchArena | None = None
    ) -> np.ndarray:
        """See ColorPart.colors."""
        out = self.base.colors(points, basis, threads, arena)
        inside = points._replace(x=np.empty_like(points.x), weights=np.empty_like(points.weights))
        kernels.restrict(*self._cells_and_box, points, threads, inside.x, inside.weights)
        own = self.own.colors(inside, None, threads, arena)
        kernels.add_logits(own, points.starts, points.ends, threads, out)
        return out

    def backward(self, points: ShadingPoints, basis, colors, color_gradients, to: np.ndarray) -> None:
        """Add dL/d(values) to the threads' buffers `to` [threads, len(values)].

        The derivative of a sigmoid follows from its value alone, whatever logits were added in it.
        """
        inside, own_colors = self._colored_inside(points, colors, len(to))
        self.own.backward(inside, None, own_colors, color_gradients, to)

    def add_position_gradients(self, points: ShadingPoints, basis, colors, color_gradients, out, threads: int) -> None:
        """Add dL/dx to out [n, 3]."""
        self.base.add_position_gradients(points, basis, colors, color_gradients, out, threads)
        inside, own_colors = self._colored_inside(points, colors, threads)
        found = np.zeros(points.x.shape, np.float32)
        self.own.add_position_gradients(inside, None, own_colors, color_gradients, found, threads)
        kernels.add_scaled(found, np.float32(1 / self.side), points.starts, points.ends, threads, out)

    def smooth(self, strength: float, to: np.ndarray) -> None:
        """Add the gradient that draws the patch to the base to buffer `to` [len(values)]."""
        self.own.smooth(strength, to)

    @property
    def _cells_and_box(self) -> tuple:
        return self._flat, self.cells, self.low.astype(np.float32), np.float32(1 / self.side)

    def _colored_inside(self, points: ShadingPoints, colors, threads: int) -> tuple[ShadingPoints, np.ndarray]:
        """Return (points with x in the box, colors with -1 in the first channel of points outside or uncolored)."""
        own_x, inside = np.empty_like(points.x), np.empty_like(colors)
        kernels.restrict_colored(*self._cells_and_box, points, colors, threads, own_x, inside)
        return points._replace(x=own_x), inside


def box_of(marked: np.ndarray) -> tuple[np.ndarray, float]:
    """(lowest corner [3], side) of the smallest cube, in cube units, around marked cells [s, s, s]."""
    where = np.argwhere(marked)
    low, high = where.min(0) / marked.shape[0], (where.max(0) + 1) / marked.shape[0]
    return low, float((high - low).max())
