"""Encoders: what a colour head reads of a place. Each is pure: its table is handed in."""

import numpy as np

from stylerf.fields.capacity import Capacity
from stylerf.fields.hash_density import add_smoothness, levels_of
from stylerf.fields.levels import Levels
from stylerf.kernels.cpu import hash_features
from stylerf.kernels.cpu.vector_hash import ROW


class HashFeatures:
    """The levels of a hash grid side by side, four floats each (Mueller et al. 2022, section 3)."""

    kind = "hash"

    def __init__(self, levels: Levels) -> None:
        self.levels, self.layout = levels, levels.layout()
        self._levels = (np.int8(0),) * levels.count

    @classmethod
    def of(cls, capacity: Capacity) -> "HashFeatures":
        return cls(levels_of(capacity, ROW))

    @property
    def width(self) -> int:
        """Features of a place."""
        return ROW * self.levels.count

    @property
    def length(self) -> int:
        """Floats of the table."""
        return self.levels.length

    def initial(self, generator: np.random.Generator) -> np.ndarray:
        return generator.uniform(-1e-1, 1e-1, self.length).astype(np.float32)

    def grown(self, table: np.ndarray, capacity: Capacity, generator) -> tuple["HashFeatures", np.ndarray]:
        """The same features at a larger capacity, and their table."""
        new = HashFeatures.of(capacity)
        return new, self.levels.regrown(table, new.levels)

    def encode(self, table: np.ndarray, x: np.ndarray, index: np.ndarray, chunks: int) -> np.ndarray:
        """[m, width] of samples x[index]."""
        out = np.empty((len(index), self.width), np.float32)
        hash_features.features(table, self.layout, self._levels, x, index, chunks, out)
        return out

    def backward(self, table, x, index, gradients: np.ndarray, to: np.ndarray) -> None:
        """Add dL/d(table) to the chunks' buffers `to` [chunks, length or more]; gradients [m, width]."""
        hash_features.features_backward(self.layout, self._levels, x, index, gradients, len(to), to)

    def add_position_gradients(self, table, x, index, gradients: np.ndarray, out: np.ndarray, chunks: int) -> None:
        """Add dL/dx to out [n, 3]."""
        hash_features.features_position_gradient(table, self.layout, self._levels, x, index, gradients, chunks, out)

    def smooth(self, table: np.ndarray, strength: float, to: np.ndarray) -> None:
        """See hash_density.add_smoothness."""
        add_smoothness(self.levels, table, strength, to)

    def describe(self) -> dict:
        return {"kind": self.kind, **self.levels.describe()}

    @classmethod
    def restore(cls, data: dict) -> "HashFeatures":
        return cls(Levels.restore(data, ROW))


FEATURES = {features.kind: features for features in (HashFeatures,)}
