"""Vector-matrix density and color (TensoRF, Chen et al. 2022), on the CPU kernels.

Every part keeps all it learns in one flat float32 array `values`, tables first. Gradients are flat buffers
[threads, len(values)] of the same layout, and one optimizer serves every kind of part.
"""

import numpy as np

from stylerf import validation
from stylerf.errors import InvalidValue
from stylerf.fields.capacity import Capacity
from stylerf.fields.marching import MarchInputs, march
from stylerf.fields.occupancy_grid import OccupancyGrid
from stylerf.fields.rank_truncation import best_ranks, best_seen_ranks, texel_weights
from stylerf.fields.scratch_arena import ScratchArena, empty_array
from stylerf.fields.vm_tables import grid_of, initial_table, resized_table, split_table, table_length, widened_table
from stylerf.geometry.spherical_harmonics import BANDS, C0
from stylerf.kernels.cpu import vm as kernels
from stylerf.kernels.cpu.deformation import color_position_gradient, density_position_gradient
from stylerf.kernels.cpu.ray_samples import Density, LinearColor, Rays, Samples, ShadingPoints


class VmDensity:
    """Raw density exp(shift + sum of features) on the unit cube. values: table, shift."""

    kind = "vm"

    def __init__(self, size: np.ndarray, rank: int, values: np.ndarray) -> None:
        self.size, self.rank, self.values = np.asarray(size, np.int64), int(rank), values
        if len(values) != (expected := table_length(self.size, self.rank) + 1):
            raise InvalidValue(f"vm density: {len(values)} values where {expected} were expected")
        self._ranks = (np.int8(0),) * self.rank

    @classmethod
    def create(cls, size: np.ndarray, rank: int, generator: np.random.Generator, shift: float = -4.0) -> "VmDensity":
        """Create a thin fog that the first rays see all of: exp(-4) is an optical depth of 1.8 across the cube."""
        table = initial_table(np.asarray(size), rank, generator, 0.1)
        return cls(size, rank, np.append(table, np.float32(shift)))

    @property
    def table(self) -> np.ndarray:
        return self.values[:-1]

    def groups(self) -> list[tuple[int, int, float]]:
        """Return (begin, end, learning-rate factor) of slices of `values`."""
        return [(0, len(self.values), 1.0)]

    def resized(self, size: np.ndarray) -> "VmDensity":
        """Return the same density on another grid, interpolated."""
        table = resized_table(self.table, self.size, np.asarray(size), self.rank)
        return VmDensity(size, self.rank, np.append(table, self.values[-1]))

    def with_rank(self, rank: int, generator: np.random.Generator) -> "VmDensity":
        """Return the same density with more ranks."""
        if rank <= self.rank:
            return self
        table = widened_table(self.table, self.size, self.rank, rank, generator)
        return VmDensity(self.size, rank, np.append(table, self.values[-1]))

    def narrowed(self, rank: int, occupancy: OccupancyGrid) -> "VmDensity":
        """Return the closest density with fewer ranks, judged where `occupancy` is occupied."""
        table = np.empty(table_length(self.size, rank), np.float32)
        weights = texel_weights(occupancy, self.size)
        old, new = split_table(self.table, self.size, self.rank), split_table(table, self.size, rank)
        for plane, line, pair, to_plane, to_line in zip(*old, weights, *new):
            best_plane, best_line = best_ranks(plane.reshape(-1, self.rank), line, pair, rank)
            to_plane[:], to_line[:] = best_plane.reshape(to_plane.shape), best_line
        return VmDensity(self.size, rank, np.append(table, self.values[-1]))

    def grown(self, capacity: Capacity, generator: np.random.Generator) -> "VmDensity":
        """Return the same density at another capacity."""
        if capacity.density_rank == self.rank and tuple(capacity.size) == tuple(self.size):
            return self
        made = self.with_rank(capacity.density_rank, generator)
        if capacity.density_rank < self.rank:
            made = self.narrowed(capacity.density_rank, capacity.occupancy)
        return made.resized(capacity.size)

    def sigma(self, x: np.ndarray, threads: int) -> np.ndarray:
        """Return raw density [n] at points [n, 3] float32 in the unit cube."""
        out = np.empty(len(x), np.float32)
        kernels.density_at(self._density, self._ranks, x, threads, out)
        return out

    @property
    def _density(self) -> Density:
        return Density(self.table, self.size, self.values[-1])

    def march(self, rays: Rays, inputs: MarchInputs) -> Samples:
        """March rays through the density."""
        return march(kernels.march_density, self._density, self._ranks, rays, inputs)

    def backward(self, samples: Samples, sigma_gradients: np.ndarray, to: np.ndarray) -> None:
        """Add dL/d(values) to the threads' buffers `to` [threads, len(values)], from dL/d(sigma) [n]."""
        kernels.density_backward(self._density, self._ranks, samples, sigma_gradients, to)

    def add_position_gradients(self, samples: Samples, sigma_gradients, out: np.ndarray, threads: int) -> None:
        """Add dL/dx to out [n, 3]."""
        density_position_gradient(self.table, self.size, self._ranks, samples, sigma_gradients, threads, out)

    def smooth(self, strength: float, to: np.ndarray) -> None:
        """Add the gradient of the planes' total variation (mean squared difference) to buffer `to` [len(values)]."""
        kernels.smoothness_backward(self.table, self.size, self._ranks, np.float32(strength / len(self.values)), to)

    def describe(self) -> dict:
        return {"kind": self.kind, "size": [int(s) for s in self.size], "rank": self.rank}

    @classmethod
    def restore(cls, data: dict, values: np.ndarray) -> "VmDensity":
        return cls(*grid_of(data), values)


class VmColor:
    """Color sigmoid(bias + sum_b Y_b(d) head_b . features(x)). values: table, head [3, bands, 3 rank], bias [3]."""

    kind = "vm"

    def __init__(self, size: np.ndarray, rank: int, degree: int, values: np.ndarray) -> None:
        self.size, self.rank, self.degree, self.values = np.asarray(size, np.int64), int(rank), int(degree), values
        self._ranks = (np.int8(0),) * self.rank
        self._head = 3 * BANDS[self.degree] * 3 * self.rank
        if len(values) != (expected := table_length(self.size, self.rank) + self._head + 3):
            raise InvalidValue(f"vm color: {len(values)} values where {expected} were expected")

    @classmethod
    def create(cls, size: np.ndarray, rank: int, degree: int, generator: np.random.Generator) -> "VmColor":
        table = initial_table(np.asarray(size), rank, generator, 0.1)
        head = generator.uniform(-1, 1, size=(3, BANDS[degree], 3 * rank)) / np.sqrt(3 * rank) / C0
        head[:, 1:] *= 0.1
        values = np.concatenate([table, head.ravel(), np.zeros(3)]).astype(np.float32)
        return cls(size, rank, degree, values)

    @property
    def table(self) -> np.ndarray:
        return self.values[: len(self.values) - 3 - self._head]

    @property
    def head(self) -> np.ndarray:
        return self.values[len(self.values) - 3 - self._head : -3]

    def groups(self) -> list[tuple[int, int, float]]:
        return [(0, len(self.table), 1.0), (len(self.table), len(self.values), 1.0)]

    def resized(self, size: np.ndarray) -> "VmColor":
        table = resized_table(self.table, self.size, np.asarray(size), self.rank)
        return VmColor(size, self.rank, self.degree, np.concatenate([table, self.head, self.values[-3:]]))

    def with_rank(self, rank: int, generator: np.random.Generator) -> "VmColor":
        """Return the same color with more ranks; the head of a new rank is random, its features zero."""
        if rank <= self.rank:
            return self
        table = widened_table(self.table, self.size, self.rank, rank, generator)
        bands = BANDS[self.degree]
        head = VmColor.create(np.full(3, 8), rank, self.degree, generator).head.reshape(3, bands, 3, rank)
        head[..., : self.rank] = self.head.reshape(3, bands, 3, self.rank)
        return VmColor(self.size, rank, self.degree, np.concatenate([table, head.ravel(), self.values[-3:]]))

    def narrowed(self, rank: int, occupancy: OccupancyGrid) -> "VmColor":
        """Return the closest color with fewer ranks, judged where `occupancy` is occupied."""
        table = np.empty(table_length(self.size, rank), np.float32)
        weights = texel_weights(occupancy, self.size)
        head = self.head.reshape(-1, 3, self.rank)
        kept_head = np.empty((len(head), 3, rank), np.float32)
        old, new = split_table(self.table, self.size, self.rank), split_table(table, self.size, rank)
        for m, (plane, line, pair, to_plane, to_line) in enumerate(zip(*old, weights, *new)):
            found = best_seen_ranks(plane.reshape(-1, self.rank), line, pair, head[:, m], rank)
            to_plane[:], to_line[:], kept_head[:, m] = found[0].reshape(to_plane.shape), *found[1:]
        values = np.concatenate([table, kept_head.ravel(), self.values[-3:]])
        return VmColor(self.size, rank, self.degree, values)

    def grown(self, capacity: Capacity, generator: np.random.Generator) -> "VmColor":
        """Return the same color at another capacity."""
        if capacity.color_rank == self.rank and tuple(capacity.size) == tuple(self.size):
            return self.with_degree(capacity.degree) if capacity.degree != self.degree else self
        made = self.with_rank(capacity.color_rank, generator)
        if capacity.color_rank < self.rank:
            made = self.narrowed(capacity.color_rank, capacity.occupancy)
        return made.resized(capacity.size).with_degree(capacity.degree)

    def with_degree(self, degree: int) -> "VmColor":
        """Return the same color with more (zero) or fewer spherical-harmonic bands."""
        old = self.head.reshape(3, BANDS[self.degree], -1)
        head = np.zeros((3, BANDS[degree], old.shape[2]), np.float32)
        shared = min(old.shape[1], head.shape[1])
        head[:, :shared] = old[:, :shared]
        return VmColor(self.size, self.rank, degree, np.concatenate([self.table, head.ravel(), self.values[-3:]]))

    @property
    def _parameters(self) -> LinearColor:
        return LinearColor(self.table, self.size, self.head, self.values[-3:])

    def colors(
        self, points: ShadingPoints, basis: np.ndarray, threads: int, arena: ScratchArena | None = None
    ) -> np.ndarray:
        """See ColorPart.colors."""
        out = empty_array((len(points.x), 3), arena)
        kernels.color(self._parameters, self._ranks, points, basis, threads, out)
        return out

    def backward(self, points: ShadingPoints, basis, colors, color_gradients, to: np.ndarray) -> None:
        """Add dL/d(values) to the threads' buffers `to` [threads, len(values)]."""
        kernels.color_backward(self._parameters, self._ranks, points, basis, colors, color_gradients, to)

    def add_position_gradients(self, points: ShadingPoints, basis, colors, color_gradients, out, threads: int) -> None:
        """Add dL/dx to out [n, 3]."""
        color_position_gradient(self._parameters, self._ranks, points, basis, colors, color_gradients, threads, out)

    def smooth(self, strength: float, to: np.ndarray) -> None:
        """See VmDensity.smooth."""
        kernels.smoothness_backward(self.table, self.size, self._ranks, np.float32(strength / len(self.table)), to)

    def describe(self) -> dict:
        return {"kind": self.kind, "size": [int(s) for s in self.size], "rank": self.rank, "degree": self.degree}

    @classmethod
    def restore(cls, data: dict, values: np.ndarray) -> "VmColor":
        return cls(*grid_of(data), validation.integer(data, "degree", 0, max(BANDS)), values)
