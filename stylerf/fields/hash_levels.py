"""The levels of a growing hash grid: coarse levels train first, fine ones are a single vertex until activated."""

from dataclasses import dataclass, replace

import numpy as np

from stylerf import validation
from stylerf.errors import InvalidValue
from stylerf.kernels.cpu.simd_hash import PRIME_X, PRIME_Y

MOST_LEVELS, MOST_CELLS, MOST_VERTICES = 32, 4096, 1 << 24


@dataclass(frozen=True)
class Levels:
    """`count` levels of `base` to `finest` cells a side, growing geometrically, with `width` floats at a vertex.

    table: most vertices of a level, a power of two. active: number of levels, the coarsest, with more than one vertex;
    the others are constant. A kernel is compiled for a number of levels, so that one serves all stages of growth.
    """

    count: int
    base: int
    finest: int
    table: int
    width: int
    active: int

    def __post_init__(self) -> None:
        sound = 1 <= self.count <= 32 and 1 <= self.base <= self.finest <= 4096 and 0 <= self.active <= self.count
        if not sound or self.table < 8 or self.table & (self.table - 1) or self.length >= 2**31:
            raise InvalidValue(
                f"hash grid: {self.count} levels (1..32), {self.active} of them active, of {self.base}..{self.finest} "
                f"cells (1..4096), tables of {self.table} vertices (a power of two)"
            )

    @property
    def cells(self) -> list[int]:
        """Cells per side of each level."""
        growth = (self.finest / self.base) ** (1 / max(self.count - 1, 1))
        return [round(self.base * growth**level) for level in range(self.count)]

    def vertices(self, level: int) -> int:
        """Vertices stored for a level."""
        return min((self.cells[level] + 1) ** 3, self.table) if level < self.active else 1

    @property
    def firsts(self) -> np.ndarray:
        """Offset of each level's first float, and the total length: [count + 1] int64."""
        return np.cumsum([0] + [self.vertices(level) * self.width for level in range(self.count)])

    @property
    def length(self) -> int:
        """Floats in all levels."""
        return int(self.firsts[-1])

    def is_direct(self, level: int) -> bool:
        """Whether each vertex of a level has its own entry."""
        return level < self.active and (self.cells[level] + 1) ** 3 <= self.table

    def layout(self) -> np.ndarray:
        """Return [6, count] int32 as the kernels read it (kernels/cpu/simd_hash.py)."""
        layout = np.empty((6, self.count), np.int32)
        for level, (cells, first) in enumerate(zip(self.cells, self.firsts)):
            if level >= self.active:
                layout[:, level] = 1, 0, 0, 0, first, -1  # every index is masked to 0
            elif self.is_direct(level):
                layout[:, level] = cells, (cells + 1) ** 2, cells + 1, 0, first, 0
            else:
                layout[:, level] = cells, PRIME_X, PRIME_Y, self.table - 1, first, -1
        return layout

    def within(self, resolution: int) -> "Levels":
        """Return the grid with the levels active that have at most `resolution` cells per side."""
        return replace(self, active=max(1, sum(cells <= resolution for cells in self.cells)))

    def regrown(self, values: np.ndarray, new: "Levels") -> np.ndarray:
        """Lay out the same values for `new`, which has other levels active and tables as large or larger.

        With more levels active the function is unchanged: an entry of a larger table starts as the one that its hash
        had in the smaller table. Deactivated levels become 0.
        """
        if replace(new, active=self.active, table=self.table) != self:
            raise InvalidValue(f"{self} cannot grow to {new}")
        if new.table < self.table:
            raise InvalidValue(f"hash tables of {self.table} vertices cannot become {new.table}")
        out = np.empty(new.length, np.float32)
        for level in range(self.count):
            source = values[self.firsts[level] : self.firsts[level + 1]].reshape(-1, self.width)
            target = out[new.firsts[level] : new.firsts[level + 1]].reshape(-1, self.width)
            target[:] = 0 if new.active <= level < self.active else source[self._entries(level, new)]
        return out

    def _entries(self, level: int, new: "Levels") -> np.ndarray:
        """Return, for each entry of a level in `new`, its old entry."""
        entries = np.arange(new.vertices(level))
        if level >= self.active:
            return np.zeros_like(entries)
        if self.is_direct(level) or not new.is_direct(level):
            return entries % self.vertices(level)
        i, j, k = np.unravel_index(entries, (self.cells[level] + 1,) * 3)
        return ((i * np.int64(PRIME_X)) ^ (j * np.int64(PRIME_Y)) ^ k) & (self.table - 1)

    def describe(self) -> dict:
        return {
            "levels": self.count,
            "base": self.base,
            "finest": self.finest,
            "table": self.table,
            "active": self.active,
        }

    @classmethod
    def restore(cls, data: dict, width: int) -> "Levels":
        return cls(*grid_of(data), width, validation.integer(data, "active", 0, MOST_LEVELS))


def grid_of(data: dict) -> tuple[int, int, int, int]:
    """Return levels, base, finest and table from the JSON form of a hash grid, each checked against its bounds."""
    levels, base = validation.integer(data, "levels", 1, MOST_LEVELS), validation.integer(data, "base", 1, MOST_CELLS)
    return (
        levels,
        base,
        validation.integer(data, "finest", 1, MOST_CELLS),
        validation.integer(data, "table", 8, MOST_VERTICES),
    )
