"""Multi-resolution hash grids (Mueller et al. 2022): density, view-independent color, and features for a color head.

Grids grow during a fit: coarse levels train first; a fine level is a single vertex until activated.
"""

from dataclasses import dataclass, replace

import numpy as np

from stylerf import validation
from stylerf.errors import InvalidValue
from stylerf.fields.marching import ScratchArena, empty_array
from stylerf.fields.protocol import Capacity
from stylerf.fields.tables import TableDensity, TableFeatures
from stylerf.kernels.cpu import hash_grid as kernels
from stylerf.kernels.cpu.ray_samples import ShadingPoints
from stylerf.kernels.cpu.simd_hash import PRIME_X, PRIME_Y, ROW

MOST_LEVELS, MOST_CELLS, MOST_VERTICES = 32, 4096, 1 << 24
DENSITY_RATE = 5.0  # learning-rate factor (decision 0018)
SPAN = 16  # ratio of the finest to the coarsest resolution


@dataclass(frozen=True)
class Levels:
    """`count` levels with `base` to `finest` cells per side, growing geometrically, and `width` floats per vertex.

    table: maximum number of vertices per level, a power of two. active: how many of the levels, coarsest first, have
    more than one vertex; the others are constant. Kernels are compiled per number of levels, so that one kernel serves
    all stages of growth.
    """

    count: int
    base: int
    finest: int
    table: int
    width: int
    active: int

    def __post_init__(self) -> None:
        levels = 1 <= self.count <= MOST_LEVELS and 0 <= self.active <= self.count
        cells = 1 <= self.base <= self.finest <= MOST_CELLS
        # The length is bounded because kernels use int32 offsets.
        if not (levels and cells) or self.table < 8 or self.table & (self.table - 1) or self.length >= 2**31:
            raise InvalidValue(
                f"hash grid: {self.count} levels (1..{MOST_LEVELS}), {self.active} of them active, {self.base}.."
                f"{self.finest} cells (1..{MOST_CELLS}), tables of {self.table} vertices (a power of two)"
            )

    @property
    def cells(self) -> list[int]:
        """Cells per side of each level."""
        # Mueller et al. 2022, eq. 2 and 3, rounded to nearest instead of down.
        growth = (self.finest / self.base) ** (1 / max(self.count - 1, 1))
        return [round(self.base * growth**level) for level in range(self.count)]

    def vertices(self, level: int) -> int:
        """Vertices stored for a level."""
        return min((self.cells[level] + 1) ** 3, self.table) if level < self.active else 1

    @property
    def firsts(self) -> np.ndarray:
        """Offset of each level's first float, then the total length: [count + 1] int64."""
        return np.cumsum([0] + [self.vertices(level) * self.width for level in range(self.count)])

    @property
    def length(self) -> int:
        """Floats in all levels."""
        return int(self.firsts[-1])

    def is_direct(self, level: int) -> bool:
        """Whether each vertex of a level has its own entry."""
        return level < self.active and (self.cells[level] + 1) ** 3 <= self.table

    def layout(self) -> np.ndarray:
        """Return the kernels' layout, [6, count] int32 (kernels/cpu/simd_hash.py)."""
        # The last row is a bit mask that selects the hashed index (-1) or the direct one (0).
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
        """Return the grid with all levels of at most `resolution` cells per side active."""
        return replace(self, active=max(1, sum(cells <= resolution for cells in self.cells)))

    def regrown(self, values: np.ndarray, new: "Levels") -> np.ndarray:
        """Convert values to the layout of `new`, which has different active levels and tables at least as large.

        If more levels become active, the function is unchanged: an entry of a larger table is initialized from the one
        that its hash selected in the smaller table. Deactivated levels become 0.
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
        """Return, for each entry of a level in `new`, the index of its old entry."""
        entries = np.arange(new.vertices(level))
        if level >= self.active:
            return np.zeros_like(entries)
        if self.is_direct(level) or not new.is_direct(level):
            # Sizes are powers of two: a hash in the smaller table is the low bits of that in the larger one.
            return entries % self.vertices(level)
        i, j, k = np.unravel_index(entries, (self.cells[level] + 1,) * 3)
        return ((i * np.int64(PRIME_X)) ^ (j * np.int64(PRIME_Y)) ^ k) & (self.table - 1)

    def describe(self, growing: bool = True) -> dict:
        grid = {"levels": self.count, "base": self.base, "finest": self.finest, "table": self.table}
        return {**grid, "active": self.active} if growing else grid

    @classmethod
    def restore(cls, data: dict, width: int) -> "Levels":
        return cls(*grid_of(data), width, validation.integer(data, "active", 0, MOST_LEVELS))


def grid_of(data: dict) -> tuple[int, int, int, int]:
    """Return levels, base, finest and table from the JSON form of a hash grid, each validated against its bounds."""
    levels, base = validation.integer(data, "levels", 1, MOST_LEVELS), validation.integer(data, "base", 1, MOST_CELLS)
    finest = validation.integer(data, "finest", 1, MOST_CELLS)
    return levels, base, finest, validation.integer(data, "table", 8, MOST_VERTICES)


def levels_of(capacity: Capacity, width: int) -> Levels:
    """Return the levels for a capacity, with `width` floats per vertex."""
    base = max(2, capacity.finest // SPAN)
    whole = Levels(capacity.levels, base, capacity.finest, capacity.table, width, capacity.levels)
    return whole.within(capacity.resolution)


def add_smoothness(levels: Levels, table: np.ndarray, strength: float, to: np.ndarray) -> None:
    """Add the gradient of a hash grid's total variation to buffer `to` [len(table) or more].

    Directly indexed levels: strength/2 times the mean squared difference of neighbors. In hashed levels, neighboring
    entries may belong to distant positions, so their values decay to zero instead, which leaves the scene to the
    coarser, smooth levels. Means are over all floats of the grid.
    """
    scale = np.float32(strength / levels.length)
    for level in range(levels.active):
        first, end = levels.firsts[level : level + 2]
        if levels.is_direct(level):
            kernels.smoothness_backward(table, levels.cells[level], first, levels.width, scale, to)
        else:
            to[first:end] += scale * table[first:end]


class HashDensity(TableDensity):
    """Raw density exp(shift + sum of all levels' interpolated values). values: the levels' tables, then shift."""

    kind, kernels = "hash", kernels

    def __init__(self, levels: Levels, values: np.ndarray) -> None:
        super().__init__(values, levels.length, levels.layout(), (np.int8(0),) * levels.count)
        self.levels = levels

    @classmethod
    def create(cls, capacity: Capacity, generator: np.random.Generator, shift: float = -4.0) -> "HashDensity":
        """Create a thin fog; see VmDensity.create."""
        levels = levels_of(capacity, 1)
        values = generator.uniform(-1e-2, 1e-2, levels.length).astype(np.float32)
        return cls(levels, np.append(values, np.float32(shift)))

    def groups(self) -> list[tuple[int, int, float]]:
        return [(0, len(self.values), DENSITY_RATE)]

    def grown(self, capacity: Capacity, generator: np.random.Generator) -> "HashDensity":
        """Return the same density with more levels active and larger tables."""
        levels = levels_of(capacity, 1)
        return HashDensity(levels, np.append(self.levels.regrown(self.table, levels), self.values[-1]))

    def smooth(self, strength: float, to: np.ndarray) -> None:
        add_smoothness(self.levels, self.table, strength, to)

    def describe(self) -> dict:
        return {"kind": self.kind, **self.levels.describe()}

    @classmethod
    def restore(cls, data: dict, values: np.ndarray) -> "HashDensity":
        return cls(Levels.restore(data, 1), values)


class HashFeatures(TableFeatures):
    """The concatenated levels of a hash grid, four floats each (Mueller et al. 2022, section 3)."""

    kind, kernels = "hash", kernels
    fixed = 0  # number of floats at the start of the table that never learn
    rate = 6.0  # learning-rate factor (decision 0018)

    def __init__(self, levels: Levels) -> None:
        super().__init__(ROW * levels.count, levels.length, levels.layout(), (np.int8(0),) * levels.count)
        self.levels = levels

    @classmethod
    def of(cls, capacity: Capacity, degree: int) -> "HashFeatures":
        """Create features for a capacity; independent of the color's spherical-harmonic degree."""
        return cls(levels_of(capacity, ROW))

    def grown(self, table: np.ndarray, capacity: Capacity) -> tuple["HashFeatures", np.ndarray]:
        """Return the same features with a larger capacity, and their table."""
        new = HashFeatures(levels_of(capacity, ROW))
        return new, self.levels.regrown(table, new.levels)

    def smooth(self, table: np.ndarray, strength: float, to: np.ndarray) -> None:
        add_smoothness(self.levels, table, strength, to)

    def describe(self) -> dict:
        return {"kind": self.kind, **self.levels.describe()}

    @classmethod
    def restore(cls, data: dict) -> "HashFeatures":
        return cls(Levels.restore(data, ROW))


DETAIL = 5.0  # cell width in cells of the finest level; see HashColor.detail_rate


class HashColor:
    """Color sigmoid(f[0:3] + f[3]), f: the sum of all levels' interpolated values. values: the levels' tables.

    View-independent, with fine local detail. The levels have `base` to `finest` cells per side; table: maximum number
    of vertices per level, a power of two. The widths below are in cells of the finest level.

    Attributes:
        detail_rate: relative learning rate of cells of width detail / DETAIL.
        detail: width at and above which cells learn at the full rate.
        broad: width beyond which the learning rate falls with the width.
        narrow: width below which cells do not learn; the coarsest level always does.
    """

    kind = "hash"
    degree = 0

    def __init__(self, levels: int, base: int, finest: int, table: int, values: np.ndarray) -> None:
        self.grid = Levels(int(levels), int(base), int(finest), int(table), ROW, int(levels))
        if len(values) != self.grid.length:
            raise InvalidValue(f"hash color: expected {self.grid.length} values, found {len(values)}")
        self.levels, self.base, self.finest, self.table = self.grid.count, int(base), int(finest), int(table)
        self.values, self.layout = values, self.grid.layout()
        self.detail_rate, self.detail, self.broad, self.narrow = 1.0, DETAIL, np.inf, 0.0
        self._shape = (np.int8(0),) * self.levels

    @classmethod
    def create(
        cls, generator: np.random.Generator, levels: int = 8, base: int = 16, finest: int = 512, table: int = 1 << 17
    ) -> "HashColor":
        """Create uniform gray with noise of 1e-2 in the values."""
        count = Levels(levels, base, finest, table, ROW, levels).length
        return cls(levels, base, finest, table, generator.uniform(-1e-2, 1e-2, count).astype(np.float32))

    def groups(self) -> list[tuple[int, int, float]]:
        if self.detail_rate == 1 and self.broad == np.inf and self.narrow <= 1:
            return [(0, len(self.values), 1.0)]
        power = np.log(self.detail_rate) / np.log(DETAIL)
        widths = self.finest / np.asarray(self.grid.cells)
        rates = np.maximum(1.0, self.detail / widths) ** power * np.minimum(1.0, self.broad / widths)
        rates[1:][widths[1:] < self.narrow] = 0
        firsts = self.grid.firsts
        return [(int(firsts[i]), int(firsts[i + 1]), float(rate)) for i, rate in enumerate(rates)]

    def colors(self, points: ShadingPoints, basis, threads: int, arena: ScratchArena | None = None) -> np.ndarray:
        out = empty_array((len(points.x), 3), arena)
        kernels.color(self.values, self.layout, self._shape, points, threads, out)
        return out

    def backward(self, points: ShadingPoints, basis, colors, color_gradients, to: np.ndarray) -> None:
        kernels.color_backward(self.layout, self._shape, points, colors, color_gradients, to)

    def add_position_gradients(self, points: ShadingPoints, basis, colors, color_gradients, out, threads: int) -> None:
        arguments = colors, color_gradients
        kernels.color_position_gradient(self.values, self.layout, self._shape, points, *arguments, threads, out)

    def smooth(self, strength: float, to: np.ndarray) -> None:
        """Add the gradient of strength/2 times the mean squared value to buffer `to` [len(values)].

        Neighboring vertices of a hashed level share entries with arbitrary positions, so their differences mean
        little. Decay to zero leaves the color to as few levels as suffice.
        """
        to += np.float32(strength / len(self.values)) * self.values

    def describe(self) -> dict:
        return {"kind": self.kind, **self.grid.describe(growing=False)}

    @classmethod
    def restore(cls, data: dict, values: np.ndarray) -> "HashColor":
        return cls(*grid_of(data), values)
