"""Vector-matrix density, color and features (TensoRF, Chen et al. 2022): planes and lines in one flat table.

Every part keeps its parameters in one flat float32 array `values`, tables first. Gradients are flat buffers
[threads, len(values)] with the same layout, so one optimizer serves every kind of part.
"""

import numpy as np

from stylerf import validation
from stylerf.errors import InvalidValue
from stylerf.fields.marching import ScratchArena, empty_array
from stylerf.fields.occupancy_grid import OccupancyGrid
from stylerf.fields.protocol import Capacity
from stylerf.fields.rank_truncation import best_ranks, best_seen_ranks, texel_weights
from stylerf.fields.tables import TableDensity, TableFeatures
from stylerf.geometry.spherical_harmonics import BANDS, C0
from stylerf.kernels.cpu import vm as kernels
from stylerf.kernels.cpu.ray_samples import LinearColor, ShadingPoints

MOST_VERTICES, MOST_RANK = 1 << 16, 64  # per axis; a kernel is compiled for each rank
_AXES = ((1, 2), (2, 0), (0, 1))


def grid_of(data: dict) -> tuple[np.ndarray, int]:
    """Return size [3] and rank from the JSON form of a part, each validated against its bounds."""
    size = validation.integers(data, "size", 3, 2, MOST_VERTICES)
    return np.array(size, np.int64), validation.integer(data, "rank", 1, MOST_RANK)


def table_length(size: np.ndarray, rank: int) -> int:
    """Return the number of floats in the planes and lines."""
    planes = sum(int(size[a]) * int(size[b]) for a, b in _AXES)
    return (planes + int(size.sum())) * rank


def split_table(table: np.ndarray, size: np.ndarray, rank: int) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return views of the table: planes [size[a], size[b], rank] and lines [size[m], rank]."""
    planes, lines, at = [], [], 0
    for a, b in _AXES:
        n = int(size[a] * size[b] * rank)
        planes.append(table[at : at + n].reshape(int(size[a]), int(size[b]), rank))
        at += n
    for m in range(3):
        n = int(size[m] * rank)
        lines.append(table[at : at + n].reshape(int(size[m]), rank))
        at += n
    return planes, lines


def initial_table(size: np.ndarray, rank: int, generator: np.random.Generator, spread: float) -> np.ndarray:
    table = np.empty(table_length(size, rank), np.float32)
    planes, lines = split_table(table, size, rank)
    for plane in planes:
        plane[:] = generator.normal(scale=spread, size=plane.shape)
    for line in lines:
        # Nonzero: where plane and line both vanish, neither gets a gradient.
        line[:] = generator.normal(scale=spread, size=line.shape) + 0.3
    return table


def widened_table(
    table: np.ndarray, size: np.ndarray, old: int, new: int, generator: np.random.Generator
) -> np.ndarray:
    """Add ranks: new planes are random, new lines zero, so that the function is unchanged."""
    out = initial_table(np.asarray(size), new, generator, 0.1)
    (planes, lines), (new_planes, new_lines) = split_table(table, size, old), split_table(out, size, new)
    for source, target in zip(planes + lines, new_planes + new_lines):
        target[..., :old] = source
    for target in new_lines:
        target[..., old:] = 0
    return out


def resized_table(table: np.ndarray, old: np.ndarray, new: np.ndarray, rank: int) -> np.ndarray:
    """Resample planes and lines to another grid: by interpolation if finer, else by least squares."""
    out = np.empty(table_length(new, rank), np.float32)
    onto = [_onto(int(before), int(after)) for before, after in zip(old, new)]
    (planes, lines), (new_planes, new_lines) = split_table(table, old, rank), split_table(out, new, rank)
    for (a, b), source, target in zip(_AXES, planes, new_planes):
        along = (onto[a] @ source.reshape(int(old[a]), -1)).reshape(-1, int(old[b]), rank)
        target[:] = np.einsum("nb,abr->anr", onto[b], along, optimize=True)
    for m, (source, target) in enumerate(zip(lines, new_lines)):
        target[:] = onto[m] @ source
    return out


def _onto(old: int, new: int) -> np.ndarray:
    """Return [new, old] float32, the linear map from values on `old` vertices to the closest approximation on `new`."""
    if new >= old:
        return _interpolation(new, old).astype(np.float32)
    return np.linalg.pinv(_interpolation(old, new)).astype(np.float32)


def _interpolation(at: int, vertices: int) -> np.ndarray:
    """Return [at, vertices]: linear interpolation of evenly spaced vertices at `at` evenly spaced points, with ends."""
    place = np.linspace(0, vertices - 1, at)
    first = np.minimum(place.astype(np.int64), vertices - 2)
    matrix = np.zeros((at, vertices))
    matrix[np.arange(at), first] = 1 - (place - first)
    matrix[np.arange(at), first + 1] += place - first
    return matrix


class VmDensity(TableDensity):
    """Raw density exp(shift + sum of features) on the unit cube. values: table, then shift."""

    kind, kernels = "vm", kernels

    def __init__(self, size: np.ndarray, rank: int, values: np.ndarray) -> None:
        self.size, self.rank = np.asarray(size, np.int64), int(rank)
        super().__init__(values, table_length(self.size, self.rank), self.size, (np.int8(0),) * self.rank)

    @classmethod
    def create(cls, size: np.ndarray, rank: int, generator: np.random.Generator, shift: float = -4.0) -> "VmDensity":
        """Create a fog that the first rays see through: exp(-4) is an optical depth of 1.8 across the cube."""
        table = initial_table(np.asarray(size), rank, generator, 0.1)
        return cls(size, rank, np.append(table, np.float32(shift)))

    def groups(self) -> list[tuple[int, int, float]]:
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

    def narrowed(self, rank: int, occupancy: OccupancyGrid | None) -> "VmDensity":
        """Return the closest density with fewer ranks, weighted by `occupancy`."""
        table = np.empty(table_length(self.size, rank), np.float32)
        weights = texel_weights(occupancy, self.size)
        old, new = split_table(self.table, self.size, self.rank), split_table(table, self.size, rank)
        for plane, line, pair, to_plane, to_line in zip(*old, weights, *new):
            best_plane, best_line = best_ranks(plane.reshape(-1, self.rank), line, pair, rank)
            to_plane[:], to_line[:] = best_plane.reshape(to_plane.shape), best_line
        return VmDensity(self.size, rank, np.append(table, self.values[-1]))

    def grown(self, capacity: Capacity, generator: np.random.Generator) -> "VmDensity":
        """Return the same density with another capacity."""
        if capacity.density_rank == self.rank and tuple(capacity.size) == tuple(self.size):
            return self
        made = self.with_rank(capacity.density_rank, generator)
        if capacity.density_rank < self.rank:
            made = self.narrowed(capacity.density_rank, capacity.occupancy)
        return made.resized(capacity.size)

    def smooth(self, strength: float, to: np.ndarray) -> None:
        """Add the gradient of the planes' total variation (mean squared difference) to buffer `to` [len(values)]."""
        kernels.smoothness_backward(self.table, self.size, self._shape, np.float32(strength / len(self.values)), to)

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
            raise InvalidValue(f"vm color: expected {expected} values, found {len(values)}")

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
        # Any grid size will do: only the new head is used.
        head = VmColor.create(np.full(3, 8), rank, self.degree, generator).head.reshape(3, bands, 3, rank)
        head[..., : self.rank] = self.head.reshape(3, bands, 3, self.rank)
        return VmColor(self.size, rank, self.degree, np.concatenate([table, head.ravel(), self.values[-3:]]))

    def narrowed(self, rank: int, occupancy: OccupancyGrid | None) -> "VmColor":
        """Return the closest color with fewer ranks, weighted by `occupancy`."""
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
        """Return the same color with another capacity."""
        if capacity.color_rank == self.rank and tuple(capacity.size) == tuple(self.size):
            return self.with_degree(capacity.degree) if capacity.degree != self.degree else self
        made = self.with_rank(capacity.color_rank, generator)
        if capacity.color_rank < self.rank:
            made = self.narrowed(capacity.color_rank, capacity.occupancy)
        return made.resized(capacity.size).with_degree(capacity.degree)

    def with_degree(self, degree: int) -> "VmColor":
        """Return the same color with more spherical-harmonic bands (zero at first) or fewer."""
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
        out = empty_array((len(points.x), 3), arena)
        kernels.color(self._parameters, self._ranks, points, basis, threads, out)
        return out

    def backward(self, points: ShadingPoints, basis, colors, color_gradients, to: np.ndarray) -> None:
        kernels.color_backward(self._parameters, self._ranks, points, basis, colors, color_gradients, to)

    def add_position_gradients(self, points: ShadingPoints, basis, colors, color_gradients, out, threads: int) -> None:
        arguments = points, basis, colors, color_gradients
        kernels.color_position_gradient(self._parameters, self._ranks, *arguments, threads, out)

    def smooth(self, strength: float, to: np.ndarray) -> None:
        kernels.smoothness_backward(self.table, self.size, self._ranks, np.float32(strength / len(self.table)), to)

    def describe(self) -> dict:
        return {"kind": self.kind, "size": [int(s) for s in self.size], "rank": self.rank, "degree": self.degree}

    @classmethod
    def restore(cls, data: dict, values: np.ndarray) -> "VmColor":
        return cls(*grid_of(data), validation.integer(data, "degree", 0, max(BANDS)), values)


class VmFeatures(TableFeatures):
    """Products of planes and lines, 3 rank of them (TensoRF, eq. 7)."""

    kind, kernels = "vm", kernels
    fixed = 0  # number of floats at the start of the table that never learn
    rate = 1.0  # learning-rate factor

    def __init__(self, size: np.ndarray, rank: int) -> None:
        self.size, self.rank = np.asarray(size, np.int64), int(rank)
        length = table_length(self.size, self.rank)
        super().__init__(3 * self.rank, length, self.size, (np.int8(0),) * self.rank)

    @classmethod
    def of(cls, capacity: Capacity, degree: int) -> "VmFeatures":
        """Create features for a capacity; independent of the color's spherical-harmonic degree."""
        return cls(capacity.size, capacity.color_rank)

    def initial(self, generator: np.random.Generator) -> np.ndarray:
        return initial_table(self.size, self.rank, generator, 0.1)

    def grown(self, table: np.ndarray, capacity: Capacity) -> tuple["VmFeatures", np.ndarray]:
        """Return the same features on another grid, and their table; the rank stays, since a head's width is fixed."""
        return VmFeatures(capacity.size, self.rank), resized_table(table, self.size, capacity.size, self.rank)

    def smooth(self, table: np.ndarray, strength: float, to: np.ndarray) -> None:
        """See VmColor.smooth."""
        kernels.smoothness_backward(table, self.size, self._shape, np.float32(strength / self.length), to)

    def describe(self) -> dict:
        return {"kind": self.kind, "size": [int(s) for s in self.size], "rank": self.rank}

    @classmethod
    def restore(cls, data: dict) -> "VmFeatures":
        return cls(*grid_of(data))
