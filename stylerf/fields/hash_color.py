"""A view-independent color with fine local detail: a multi-resolution hash grid (Mueller et al. 2022)."""

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.fields.hash_levels import grid_of
from stylerf.fields.scratch_arena import ScratchArena, empty_array
from stylerf.kernels.cpu import hash_color as kernels
from stylerf.kernels.cpu.ray_samples import ShadingPoints
from stylerf.kernels.cpu.simd_hash import PRIME_X, PRIME_Y, ROW


def level_layout(levels: int, base: int, finest: int, table: int) -> tuple[np.ndarray, int]:
    """Return ([6, levels] int32 as the kernels read it, floats in all levels); resolutions grow geometrically.

    Rows: cells a side, multiplier of x and of y, mask, first float, -1 where hashed (see kernels/cpu/simd_hash.py).
    """
    growth = (finest / base) ** (1 / max(levels - 1, 1))
    layout = np.empty((6, levels), np.int32)
    at = 0
    for level in range(levels):
        cells = round(base * growth**level)
        vertices = (cells + 1) ** 3
        if vertices <= table:
            layout[:, level] = cells, (cells + 1) ** 2, cells + 1, 0, at, 0
        else:
            layout[:, level] = cells, PRIME_X, PRIME_Y, table - 1, at, -1
        at += min(vertices, table) * ROW
    return layout, at


class HashColor:
    """Color sigmoid(f[0:3] + f[3]), f the sum of all levels' interpolated values. values: the levels' tables.

    levels of `base` to `finest` cells per side; table: most vertices of a level, a power of two.
    """

    kind = "hash"
    degree = 0

    def __init__(self, levels: int, base: int, finest: int, table: int, values: np.ndarray) -> None:
        if not 1 <= levels <= 32 or not 1 <= base <= finest <= 4096 or table < 8 or table & (table - 1):
            raise InvalidValue(
                f"hash color: {levels} levels (1..32) of {base}..{finest} cells (1..4096), tables of {table} vertices "
                "(a power of two)"
            )
        self.levels, self.base, self.finest, self.table = int(levels), int(base), int(finest), int(table)
        self.layout, expected = level_layout(self.levels, self.base, self.finest, self.table)
        if expected >= 2**31 or len(values) != expected:
            raise InvalidValue(f"hash color: {len(values)} values where {expected} were expected")
        self.values = values
        self._levels = (np.int8(0),) * self.levels

    @classmethod
    def create(
        cls, generator: np.random.Generator, levels: int = 8, base: int = 16, finest: int = 512, table: int = 1 << 17
    ) -> "HashColor":
        """Create an even gray with a hundredth of noise."""
        count = level_layout(levels, base, finest, table)[1]
        values = generator.uniform(-1e-2, 1e-2, count).astype(np.float32)
        return cls(levels, base, finest, table, values)

    def groups(self) -> list[tuple[int, int, float]]:
        """Return (begin, end, learning-rate factor) of slices of `values`."""
        return [(0, len(self.values), 1.0)]

    def colors(self, points: ShadingPoints, basis, threads: int, arena: ScratchArena | None = None) -> np.ndarray:
        """See ColorPart.colors; basis is not used, the color does not depend on the view."""
        out = empty_array((len(points.x), 3), arena)
        kernels.color(self.values, self.layout, self._levels, points, threads, out)
        return out

    def backward(self, points: ShadingPoints, basis, colors, color_gradients, to: np.ndarray) -> None:
        """Add dL/d(values) to the threads' buffers `to` [threads, len(values)]."""
        kernels.color_backward(self.layout, self._levels, points, colors, color_gradients, to)

    def add_position_gradients(self, points: ShadingPoints, basis, colors, color_gradients, out, threads: int) -> None:
        """Add dL/dx to out [n, 3]."""
        kernels.color_position_gradient(
            self.values, self.layout, self._levels, points, colors, color_gradients, threads, out
        )

    def smooth(self, strength: float, to: np.ndarray) -> None:
        """Add the gradient of strength/2 times the mean squared value to buffer `to` [len(values)].

        Neighboring vertices of a hashed level share entries with arbitrary places, so that their differences mean
        little. Decay to zero leaves the color to as few levels as suffice.
        """
        to += np.float32(strength / len(self.values)) * self.values

    def describe(self) -> dict:
        return {
            "kind": self.kind,
            "levels": self.levels,
            "base": self.base,
            "finest": self.finest,
            "table": self.table,
        }

    @classmethod
    def restore(cls, data: dict, values: np.ndarray) -> "HashColor":
        return cls(*grid_of(data), values)
