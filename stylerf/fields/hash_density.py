"""A multi-resolution hash grid (Mueller et al. 2022) as a density, one float per vertex."""

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.fields.capacity import Capacity
from stylerf.fields.hash_levels import Levels
from stylerf.fields.marching import MarchInputs, march
from stylerf.kernels.cpu import hash_density as kernels
from stylerf.kernels.cpu.ray_samples import Density, Rays, Samples

RATE_FACTOR = 5.0  # of the learning rate (decision 0018)
SPAN = 16  # ratio of the finest to the coarsest resolution


def levels_of(capacity: Capacity, width: int) -> Levels:
    """Return the levels of a capacity, with `width` floats per vertex."""
    base = max(2, capacity.finest // SPAN)
    whole = Levels(capacity.levels, base, capacity.finest, capacity.table, width, capacity.levels)
    return whole.within(capacity.resolution)


def add_smoothness(levels: Levels, table: np.ndarray, strength: float, to: np.ndarray) -> None:
    """Add the gradient of a hash grid's total variation to buffer `to` [len(table) or more].

    For directly indexed levels: strength/2 times the mean squared difference of neighbors. In hashed levels neighboring
    entries may belong to distant places; their values decay to zero instead, which leaves the scene to the coarser,
    smooth levels. Means are over all floats of the grid.
    """
    strength = np.float32(strength / levels.length)
    for level in range(levels.active):
        first, end = levels.firsts[level : level + 2]
        if levels.is_direct(level):
            kernels.smoothness_backward(table, levels.cells[level], first, levels.width, strength, to)
        else:
            to[first:end] += strength * table[first:end]


class HashDensity:
    """Raw density exp(shift + sum of all levels' interpolated values). values: levels' tables, shift."""

    kind = "hash"

    def __init__(self, levels: Levels, values: np.ndarray) -> None:
        if len(values) != levels.length + 1:
            raise InvalidValue(f"hash density: {len(values)} values where {levels.length + 1} were expected")
        self.levels, self.values = levels, values
        self.layout = levels.layout()
        self._levels = (np.int8(0),) * levels.count

    @classmethod
    def create(cls, capacity: Capacity, generator: np.random.Generator, shift: float = -4.0) -> "HashDensity":
        """Create a thin fog, as VmDensity.create does."""
        levels = levels_of(capacity, 1)
        values = generator.uniform(-1e-2, 1e-2, levels.length).astype(np.float32)
        return cls(levels, np.append(values, np.float32(shift)))

    @property
    def table(self) -> np.ndarray:
        return self.values[:-1]

    def groups(self) -> list[tuple[int, int, float]]:
        """Return (begin, end, learning-rate factor) of slices of `values`."""
        return [(0, len(self.values), RATE_FACTOR)]

    def grown(self, capacity: Capacity, generator: np.random.Generator) -> "HashDensity":
        """Return the same density with more levels active and larger tables."""
        levels = levels_of(capacity, 1)
        return HashDensity(levels, np.append(self.levels.regrown(self.table, levels), self.values[-1]))

    def sigma(self, x: np.ndarray, threads: int) -> np.ndarray:
        """Return raw density [n] at points [n, 3] float32 in the unit cube."""
        out = np.empty(len(x), np.float32)
        kernels.density_at(self._density, self._levels, x, threads, out)
        return out

    @property
    def _density(self) -> Density:
        return Density(self.table, self.layout, self.values[-1])

    def march(self, rays: Rays, inputs: MarchInputs) -> Samples:
        """March rays through the density."""
        return march(kernels.march_density, self._density, self._levels, rays, inputs)

    def backward(self, samples: Samples, sigma_gradients: np.ndarray, to: np.ndarray) -> None:
        """Add dL/d(values) to the threads' buffers `to` [threads, len(values)], from dL/d(sigma) [n]."""
        kernels.density_backward(self.layout, self._levels, samples, sigma_gradients, to)

    def add_position_gradients(self, samples: Samples, sigma_gradients, out: np.ndarray, threads: int) -> None:
        """Add dL/dx to out [n, 3]."""
        kernels.density_position_gradient(self.table, self.layout, self._levels, samples, sigma_gradients, threads, out)

    def smooth(self, strength: float, to: np.ndarray) -> None:
        """See add_smoothness."""
        add_smoothness(self.levels, self.table, strength, to)

    def describe(self) -> dict:
        return {"kind": self.kind, **self.levels.describe()}

    @classmethod
    def restore(cls, data: dict, values: np.ndarray) -> "HashDensity":
        return cls(Levels.restore(data, 1), values)
