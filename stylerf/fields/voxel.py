"""A sparse voxel grid (as in ARF; Fridovich-Keil et al. 2022) as a density and as features for a color head."""

import base64
import zlib
from math import prod

import numpy as np

from stylerf import validation
from stylerf.errors import InvalidValue
from stylerf.fields.occupancy_grid import OccupancyGrid
from stylerf.fields.protocol import Capacity
from stylerf.fields.tables import TableDensity, TableFeatures
from stylerf.geometry.spherical_harmonics import BANDS
from stylerf.kernels.cpu import voxel as kernels

BLOCK = 4  # vertices per side; at 256^3 a block is a cell of a 64^3 occupancy grid
# Learning-rate factor: a step changes a single voxel, but all factors of a vm product at once (decision 0018).
RATE_FACTOR = 15.0
MAX_BLOCKS = 1 << 25  # per grid, allocated or not; 1024^3 vertices have half as many
EMPTY = -8.0  # exponent where no block is allocated: an optical depth of 6e-4 across the cube


class Grid:
    """The allocated blocks of BLOCK^3 vertices in a grid of `size` [3] vertices. kept: [blocks per axis] bool.

    A table has one more block: the first is shared by all blocks that are not allocated.
    """

    def __init__(self, size: np.ndarray, kept: np.ndarray) -> None:
        self.size = np.asarray(size, np.int64)
        blocks = -(-self.size // BLOCK)
        if (self.size < 2).any() or kept.dtype != bool or kept.shape != tuple(blocks):
            raise InvalidValue(f"voxel grid {self.size.tolist()}: blocks {kept.shape} {kept.dtype}, {blocks.tolist()}")
        self.kept = kept
        # Blocks are numbered from 1; 0 is the shared one.
        numbers = np.where(kept, np.cumsum(kept.ravel()).reshape(kept.shape), 0).ravel()
        self.links = np.concatenate([self.size, blocks, numbers]).astype(np.int32)

    @classmethod
    def of(cls, capacity: Capacity) -> "Grid":
        """Create a grid with all of a capacity's vertices, or only those around its occupied cells."""
        blocks = tuple(-(-np.asarray(capacity.size, np.int64) // BLOCK))
        if capacity.occupancy is None:
            return cls(capacity.size, np.ones(blocks, np.bool_))
        return cls(capacity.size, _touched(capacity.occupancy, np.asarray(capacity.size), blocks))

    @property
    def rows(self) -> int:
        """Number of rows in a table."""
        return (int(self.kept.sum()) + 1) * BLOCK**3

    def vertices(self) -> np.ndarray:
        """Return the positions [rows, 3] of a table's rows, clipped to the cube; the first block is at the origin."""
        # A fine grid has millions of rows: use float32 throughout, and no temporaries larger than the result.
        corner = np.concatenate([np.zeros((1, 3), np.int64), np.argwhere(self.kept)]).astype(np.float32) * BLOCK
        within = np.stack(np.unravel_index(np.arange(BLOCK**3), (BLOCK,) * 3), 1).astype(np.float32)
        places = (corner[:, None] + within[None]).reshape(-1, 3)
        places /= (self.size - 1).astype(np.float32)
        return np.clip(places, 0, 1, out=places)

    def describe(self) -> dict:
        """Return JSON; the bits of `kept` are compressed (zlib, base64), a few kilobytes for a 256^3 grid."""
        bits = zlib.compress(np.packbits(self.kept).tobytes(), 9)
        return {"size": self.size.tolist(), "kept": base64.b64encode(bits).decode()}

    @classmethod
    def restore(cls, data: dict) -> "Grid":
        size = validation.integers(data, "size", 3, 2, BLOCK * MAX_BLOCKS)
        blocks = [-(-side // BLOCK) for side in size]
        count = prod(blocks)
        if count > MAX_BLOCKS:
            raise InvalidValue(f"voxel grid {size}: {count} blocks, at most {MAX_BLOCKS} are supported")
        expected = -(-count // 8)
        try:
            packed = base64.b64decode(validation.entry(data, "kept", str), validate=True)
            bits = zlib.decompressobj().decompress(packed, expected + 1)  # a few bytes can inflate to gigabytes
        except (zlib.error, ValueError) as error:
            raise InvalidValue(f"voxel grid: the list of blocks is damaged ({error})") from error
        if len(bits) != expected:
            raise InvalidValue(f"voxel grid {size}: the list of blocks should have {expected} bytes")
        kept = np.unpackbits(np.frombuffer(bits, np.uint8), count=count).astype(bool)
        return cls(np.array(size), kept.reshape(blocks))


def _touched(occupancy: OccupancyGrid, size: np.ndarray, blocks: tuple[int, int, int]) -> np.ndarray:
    """Return [blocks] bool: the blocks with a vertex of any grid cell that overlaps an occupied cell.

    Adding neighboring cells makes a field 1.6 times as large but no better (lego, 400 steps: 27.84 dB either way).
    """
    found = (occupancy.distances == 0).reshape((occupancy.cells,) * 3)
    for axis in range(3):
        first = np.arange(blocks[axis]) * BLOCK
        # Vertex v contributes between v - 1 and v + 1, in cells of the voxel grid.
        low = np.clip((first - 1) / (size[axis] - 1) * occupancy.cells, 0, occupancy.cells - 1).astype(np.int64)
        high = np.clip((first + BLOCK) / (size[axis] - 1) * occupancy.cells, 0, occupancy.cells - 1).astype(np.int64)
        sums = np.cumsum(found, axis=axis, dtype=np.int64)
        sums = np.concatenate([np.zeros_like(sums.take([0], axis)), sums], axis)
        found = sums.take(high + 1, axis) > sums.take(low, axis)
    return found


class VoxelDensity(TableDensity):
    """Raw density exp(shift + interpolated vertex values) on the unit cube. values: table [rows], then shift."""

    kind, kernels = "voxel", kernels

    def __init__(self, grid: Grid, values: np.ndarray) -> None:
        super().__init__(values, grid.rows, grid.links, (np.int8(0),))
        self.grid = grid

    @classmethod
    def create(cls, capacity: Capacity, generator: np.random.Generator, shift: float = -4.0) -> "VoxelDensity":
        """Create a thin fog; see VmDensity.create."""
        grid = Grid.of(capacity)
        values = np.append(generator.normal(scale=1e-2, size=grid.rows), shift).astype(np.float32)
        values[: BLOCK**3] = EMPTY
        return cls(grid, values)

    def groups(self) -> list[tuple[int, int, float]]:
        """See Part.groups; the shared block 0 never learns."""
        return [(BLOCK**3, len(self.values), RATE_FACTOR)]

    def grown(self, capacity: Capacity, generator: np.random.Generator) -> "VoxelDensity":
        """Return the same density, interpolated to another grid where space is occupied, EMPTY elsewhere."""
        grid = Grid.of(capacity)
        table = sampled(self.grid, self.table, (np.int8(0),), grid)
        table[: BLOCK**3] = EMPTY
        return VoxelDensity(grid, np.append(table, self.values[-1]))

    def smooth(self, strength: float, to: np.ndarray) -> None:
        """Add the gradient of strength/2 times the mean squared difference of neighbors to buffer `to`."""
        kernels.smoothness_backward(self.table, self.layout, 1, np.float32(strength / len(self.table)), to)

    def describe(self) -> dict:
        return {"kind": self.kind, **self.grid.describe()}

    @classmethod
    def restore(cls, data: dict, values: np.ndarray) -> "VoxelDensity":
        return cls(Grid.restore(data), values)


class VoxelFeatures(TableFeatures):
    """`width` trilinearly interpolated numbers per voxel vertex; for the harmonic head, its coefficients."""

    kind, kernels = "voxel", kernels
    rate = RATE_FACTOR  # learning-rate factor

    def __init__(self, grid: Grid, width: int) -> None:
        super().__init__(width, grid.rows * width, grid.links, (np.int8(0),) * width)
        self.grid, self.fixed = grid, BLOCK**3 * width  # number of floats at the start of the table that never learn

    @classmethod
    def of(cls, capacity: Capacity, degree: int) -> "VoxelFeatures":
        return cls(Grid.of(capacity), 3 * BANDS[degree])

    def grown(self, table: np.ndarray, capacity: Capacity) -> tuple["VoxelFeatures", np.ndarray]:
        """Return the same features interpolated to another grid, and their table."""
        new = VoxelFeatures(Grid.of(capacity), self.width)
        return new, sampled(self.grid, table, self._shape, new.grid)

    def smooth(self, table: np.ndarray, strength: float, to: np.ndarray) -> None:
        kernels.smoothness_backward(table, self.layout, self.width, np.float32(strength / self.length), to)

    def describe(self) -> dict:
        return {"kind": self.kind, **self.grid.describe(), "width": self.width}

    @classmethod
    def restore(cls, data: dict) -> "VoxelFeatures":
        return cls(Grid.restore(data), validation.integer(data, "width", 1, 3 * max(BANDS.values())))


def sampled(old: Grid, table: np.ndarray, widths: tuple, new: Grid) -> np.ndarray:
    """Return the table of `new`, flat, interpolated from `old`'s table."""
    x = new.vertices()
    out = np.empty((len(x), len(widths)), np.float32)
    kernels.features(table, old.links, widths, x, np.arange(len(x)), 1, out)
    return out.ravel()
