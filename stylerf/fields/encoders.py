"""Encoders: features of a position for a color head. Each is pure: its table is an argument."""

import numpy as np

from stylerf.fields.capacity import Capacity
from stylerf.fields.hash_density import add_smoothness, levels_of
from stylerf.fields.hash_levels import Levels
from stylerf.fields.vm_tables import grid_of, initial_table, resized_table, table_length
from stylerf.fields.voxel import VoxelFeatures
from stylerf.kernels.cpu import hash_features, vm, vm_features
from stylerf.kernels.cpu.simd_hash import ROW


class HashFeatures:
    """The concatenated levels of a hash grid, four floats each (Mueller et al. 2022, section 3)."""

    kind = "hash"
    fixed = 0  # floats, the table's first, that never learn
    rate = 6.0  # factor of the learning rate (docs/decisions/0018)

    def __init__(self, levels: Levels) -> None:
        self.levels, self.layout = levels, levels.layout()
        self._levels = (np.int8(0),) * levels.count

    @classmethod
    def of(cls, capacity: Capacity, degree: int) -> "HashFeatures":
        """Create features of a capacity; the degree of the color's harmonics does not change them."""
        return cls(levels_of(capacity, ROW))

    @property
    def width(self) -> int:
        """Features per point."""
        return ROW * self.levels.count

    @property
    def length(self) -> int:
        """Floats in the table."""
        return self.levels.length

    def initial(self, generator: np.random.Generator) -> np.ndarray:
        return generator.uniform(-1e-1, 1e-1, self.length).astype(np.float32)

    def grown(self, table: np.ndarray, capacity: Capacity, generator) -> tuple["HashFeatures", np.ndarray]:
        """Return the same features at a larger capacity, and their table."""
        new = HashFeatures(levels_of(capacity, ROW))
        return new, self.levels.regrown(table, new.levels)

    def encode(self, table: np.ndarray, x: np.ndarray, index: np.ndarray, threads: int) -> np.ndarray:
        """Return features [m, width] of samples x[index], x [n, 3] in the unit cube."""
        out = np.empty((len(index), self.width), np.float32)
        hash_features.features(table, self.layout, self._levels, x, index, threads, out)
        return out

    def backward(self, table, x, index, gradients: np.ndarray, to: np.ndarray) -> None:
        """Add dL/d(table) to the threads' buffers `to` [threads, length or more]; gradients [m, width]."""
        hash_features.features_backward(self.layout, self._levels, x, index, gradients, len(to), to)

    def add_position_gradients(self, table, x, index, gradients: np.ndarray, out: np.ndarray, threads: int) -> None:
        """Add dL/dx to out [n, 3]."""
        hash_features.features_position_gradient(table, self.layout, self._levels, x, index, gradients, threads, out)

    def smooth(self, table: np.ndarray, strength: float, to: np.ndarray) -> None:
        """See hash_density.add_smoothness."""
        add_smoothness(self.levels, table, strength, to)

    def describe(self) -> dict:
        return {"kind": self.kind, **self.levels.describe()}

    @classmethod
    def restore(cls, data: dict) -> "HashFeatures":
        return cls(Levels.restore(data, ROW))


class VmFeatures:
    """Products of planes and lines, three times `rank` of them (TensoRF, eq. 7)."""

    kind = "vm"
    fixed = 0  # floats, the table's first, that never learn
    rate = 1.0  # factor of the learning rate

    def __init__(self, size: np.ndarray, rank: int) -> None:
        self.size, self.rank = np.asarray(size, np.int64), int(rank)
        self._ranks = (np.int8(0),) * self.rank

    @classmethod
    def of(cls, capacity: Capacity, degree: int) -> "VmFeatures":
        """Create features of a capacity; the degree of the color's harmonics does not change them."""
        return cls(capacity.size, capacity.color_rank)

    @property
    def width(self) -> int:
        """Features per point."""
        return 3 * self.rank

    @property
    def length(self) -> int:
        """Floats in the table."""
        return table_length(self.size, self.rank)

    def initial(self, generator: np.random.Generator) -> np.ndarray:
        return initial_table(self.size, self.rank, generator, 0.1)

    def grown(self, table: np.ndarray, capacity: Capacity, generator) -> tuple["VmFeatures", np.ndarray]:
        """Return the same features on another grid, and their table; a head has one width, so the rank stays."""
        return VmFeatures(capacity.size, self.rank), resized_table(table, self.size, capacity.size, self.rank)

    def encode(self, table: np.ndarray, x: np.ndarray, index: np.ndarray, threads: int) -> np.ndarray:
        """Return features [m, width] of samples x[index], x [n, 3] in the unit cube."""
        out = np.empty((len(index), self.width), np.float32)
        vm_features.features(table, self.size, self._ranks, x, index, threads, out)
        return out

    def backward(self, table, x, index, gradients: np.ndarray, to: np.ndarray) -> None:
        """Add dL/d(table) to the threads' buffers `to` [threads, length or more]; gradients [m, width]."""
        vm_features.features_backward(table, self.size, self._ranks, x, index, gradients, len(to), to)

    def add_position_gradients(self, table, x, index, gradients: np.ndarray, out: np.ndarray, threads: int) -> None:
        """Add dL/dx to out [n, 3]."""
        vm_features.features_position_gradient(table, self.size, self._ranks, x, index, gradients, threads, out)

    def smooth(self, table: np.ndarray, strength: float, to: np.ndarray) -> None:
        """As VmColor.smooth."""
        vm.smoothness_backward(table, self.size, self._ranks, np.float32(strength / self.length), to)

    def describe(self) -> dict:
        return {"kind": self.kind, "size": [int(s) for s in self.size], "rank": self.rank}

    @classmethod
    def restore(cls, data: dict) -> "VmFeatures":
        return cls(*grid_of(data))


FEATURES = {features.kind: features for features in (VmFeatures, HashFeatures, VoxelFeatures)}
