"""Densities and features that kernels interpolate from one flat table; the kinds differ in how the table is laid out.

kernels: the kind's module of kernels/cpu. layout: of the table, as they read it. shape: a tuple whose length (a rank, a
number of levels) they need at compile time.
"""

from types import ModuleType

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.fields.marching import MarchInputs, empty_array
from stylerf.kernels.cpu.ray_samples import Density, Rays, Samples


class TableDensity:
    """Raw density exp(shift + interpolated table) on the unit cube: a DensityPart. values: table, shift."""

    kind: str
    kernels: ModuleType

    def __init__(self, values: np.ndarray, length: int, layout: np.ndarray, shape: tuple) -> None:
        """length: of the table."""
        self.values, self.layout, self._shape = values, layout, shape
        if len(values) != length + 1:
            raise InvalidValue(f"{self.kind} density: {len(values)} values where {length + 1} were expected")

    @property
    def table(self) -> np.ndarray:
        return self.values[:-1]

    @property
    def _density(self) -> Density:
        return Density(self.table, self.layout, self.values[-1])

    def sigma(self, x: np.ndarray, threads: int) -> np.ndarray:
        out = np.empty(len(x), np.float32)
        self.kernels.density_at(self._density, self._shape, x, threads, out)
        return out

    def march(self, rays: Rays, inputs: MarchInputs) -> Samples:
        """March rays to samples with room for samples_per_ray on every ray.

        Only the pages that are written take memory.
        """
        n, arena = len(rays.origins), inputs.arena
        size = n * inputs.settings.samples_per_ray
        t, deltas, sigma, weights = (empty_array((size,), arena) for _ in range(4))
        starts, ends = np.empty(n, np.int64), np.empty(n, np.int64)
        samples = Samples(starts, ends, t, deltas, empty_array((size, 3), arena), sigma, weights)
        self.kernels.march_density(
            self._density, self._shape, rays, inputs.space, inputs.occupancy, inputs.displacement, inputs.settings,
            inputs.threads, samples,
        )  # fmt: skip
        return samples

    def backward(self, samples: Samples, sigma_gradients: np.ndarray, to: np.ndarray) -> None:
        self.kernels.density_backward(self._density, self._shape, samples, sigma_gradients, to)

    def add_position_gradients(self, samples: Samples, sigma_gradients, out: np.ndarray, threads: int) -> None:
        self.kernels.density_position_gradient(self._density, self._shape, samples, sigma_gradients, threads, out)


class TableFeatures:
    """`width` features per point, for a color head. Pure: the table, `length` floats, is an argument."""

    kernels: ModuleType

    def __init__(self, width: int, length: int, layout: np.ndarray, shape: tuple) -> None:
        self.width, self.length, self.layout, self._shape = width, length, layout, shape

    def initial(self, generator: np.random.Generator) -> np.ndarray:
        """Return random values of a table, small ones of either sign."""
        return generator.uniform(-1e-1, 1e-1, self.length).astype(np.float32)

    def encode(
        self, table: np.ndarray, x: np.ndarray, index: np.ndarray, threads: int, out: np.ndarray | None = None
    ) -> np.ndarray:
        """Return features [m, width] of samples x[index], x [n, 3] in the unit cube; in `out` if it is given."""
        out = np.empty((len(index), self.width), np.float32) if out is None else out
        self.kernels.features(table, self.layout, self._shape, x, index, threads, out)
        return out

    def backward(self, table, x, index, gradients: np.ndarray, to: np.ndarray) -> None:
        """Add dL/d(table) to the threads' buffers `to` [threads, length or more]; gradients [m, width]."""
        self.kernels.features_backward(table, self.layout, self._shape, x, index, gradients, len(to), to)

    def add_position_gradients(self, table, x, index, gradients: np.ndarray, out: np.ndarray, threads: int) -> None:
        """Add dL/dx to out [n, 3]."""
        self.kernels.features_position_gradient(table, self.layout, self._shape, x, index, gradients, threads, out)
