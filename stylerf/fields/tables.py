"""Densities and features that kernels interpolate from one flat table; kinds differ in the layout of the table.

kernels: the kind's module in kernels/cpu. layout: of the table, in the form the kernels expect. shape: a tuple whose
length (a rank, a number of levels) the kernels need at compile time.
"""

from types import ModuleType

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.fields.marching import MarchInputs, empty_array
from stylerf.kernels.cpu.ray_samples import Density, Rays, Samples


class TableDensity:
    """A DensityPart: raw density exp(shift + interpolated table) on the unit cube. values: table, then shift."""

    kind: str
    kernels: ModuleType

    def __init__(self, values: np.ndarray, length: int, layout: np.ndarray, shape: tuple) -> None:
        """length: of the table."""
        self.values, self.layout, self._shape = values, layout, shape
        if len(values) != length + 1:
            raise InvalidValue(f"{self.kind} density: expected {length + 1} values, found {len(values)}")

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
        """March rays to samples, reserving room for samples_per_ray samples on every ray.

        Only pages that are written take up memory.
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
    """`width` features per point, for a color head. Stateless: the table, `length` floats, is an argument."""

    kernels: ModuleType

    def __init__(self, width: int, length: int, layout: np.ndarray, shape: tuple) -> None:
        self.width, self.length, self.layout, self._shape = width, length, layout, shape

    def initial(self, generator: np.random.Generator) -> np.ndarray:
        """Return a table of small random values of either sign."""
        return generator.uniform(-1e-1, 1e-1, self.length).astype(np.float32)

    def encode(
        self, table: np.ndarray, x: np.ndarray, index: np.ndarray, threads: int, out: np.ndarray | None = None
    ) -> np.ndarray:
        """Return features [m, width] of samples x[index], x [n, 3] in the unit cube, written to `out` if given."""
        out = np.empty((len(index), self.width), np.float32) if out is None else out
        self.kernels.features(table, self.layout, self._shape, x, index, threads, out)
        return out

    def backward(self, table, x, index, gradients: np.ndarray, to: np.ndarray) -> None:
        """Add dL/d(table) to the per-thread buffers `to` [threads, length or more], from gradients [m, width]."""
        self.kernels.features_backward(table, self.layout, self._shape, x, index, gradients, len(to), to)

    def add_position_gradients(self, table, x, index, gradients: np.ndarray, out: np.ndarray, threads: int) -> None:
        """Add dL/dx to out [n, 3]."""
        self.kernels.features_position_gradient(table, self.layout, self._shape, x, index, gradients, threads, out)
