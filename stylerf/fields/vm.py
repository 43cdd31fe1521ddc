"""Vector-matrix density and colour (TensoRF, Chen et al. 2022), on the CPU kernels.

Every part keeps all it can learn in one flat float32 array `values` (tables first, then what is beside them), so that
gradients are flat buffers [chunks, len(values)] of the same layout and one optimiser serves every kind of part.
"""

import numpy as np
import torch
import torch.nn.functional as F

from stylerf.fields.capacity import Capacity
from stylerf.fields.samples import Samples
from stylerf.fields.walking import walk
from stylerf.geometry.harmonics import BANDS, C0
from stylerf.kernels.cpu import vm as kernels
from stylerf.kernels.cpu.deform import colour_position_gradient, density_position_gradient

_AXES = ((1, 2), (2, 0), (0, 1))


def table_length(size: np.ndarray, rank: int) -> int:
    """Floats of the planes and lines."""
    planes = sum(int(size[a]) * int(size[b]) for a, b in _AXES)
    return (planes + int(size.sum())) * rank


def split_table(table: np.ndarray, size: np.ndarray, rank: int) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Views: planes [size[a], size[b], rank] and lines [size[m], rank]."""
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
        line[:] = generator.normal(scale=spread, size=line.shape) + 0.3
    return table


def _widened_table(
    table: np.ndarray, size: np.ndarray, old: int, new: int, generator: np.random.Generator
) -> np.ndarray:
    """The same field with more ranks: new planes random, new lines zero, so that nothing changes until they learn."""
    out = initial_table(np.asarray(size), new, generator, 0.1)
    for source, target in zip(split_table(table, size, old)[0], split_table(out, size, new)[0]):
        target[..., :old] = source
    for source, target in zip(split_table(table, size, old)[1], split_table(out, size, new)[1]):
        target[..., :old] = source
        target[..., old:] = 0
    return out


def resized_table(table: np.ndarray, old: np.ndarray, new: np.ndarray, rank: int) -> np.ndarray:
    out = np.empty(table_length(new, rank), np.float32)
    for source, target in zip(split_table(table, old, rank)[0], split_table(out, new, rank)[0]):
        image = torch.from_numpy(np.ascontiguousarray(source)).permute(2, 0, 1)[None]
        grown = F.interpolate(image, size=target.shape[:2], mode="bilinear", align_corners=True)
        target[:] = grown[0].permute(1, 2, 0).numpy()
    for source, target in zip(split_table(table, old, rank)[1], split_table(out, new, rank)[1]):
        row = torch.from_numpy(np.ascontiguousarray(source)).T[None]
        target[:] = F.interpolate(row, size=target.shape[0], mode="linear", align_corners=True)[0].T.numpy()
    return out


class VmDensity:
    """Raw density exp(shift + sum of features) on the unit cube. values: table, shift."""

    kind = "vm"

    def __init__(self, size: np.ndarray, rank: int, values: np.ndarray) -> None:
        self.size, self.rank, self.values = np.asarray(size, np.int64), int(rank), values
        self._ranks = (np.int8(0),) * self.rank

    @classmethod
    def create(cls, size: np.ndarray, rank: int, generator: np.random.Generator, shift: float = -4.0) -> "VmDensity":
        """A thin fog: exp(-4) is an optical depth of about 1.8 across the cube, so the first rays see all of it."""
        table = initial_table(np.asarray(size), rank, generator, 0.1)
        return cls(size, rank, np.append(table, np.float32(shift)))

    @property
    def table(self) -> np.ndarray:
        return self.values[:-1]

    def groups(self) -> list[tuple[int, int, float]]:
        """(begin, end, learning-rate factor) of parts of `values`."""
        return [(0, len(self.values), 1.0)]

    def resized(self, size: np.ndarray) -> "VmDensity":
        """The same density on another grid, interpolated."""
        table = resized_table(self.table, self.size, np.asarray(size), self.rank)
        return VmDensity(size, self.rank, np.append(table, self.values[-1]))

    def with_rank(self, rank: int, generator: np.random.Generator) -> "VmDensity":
        """The same density with more ranks."""
        if rank <= self.rank:
            return self
        table = _widened_table(self.table, self.size, self.rank, rank, generator)
        return VmDensity(self.size, rank, np.append(table, self.values[-1]))

    def grown(self, capacity: Capacity, generator: np.random.Generator) -> "VmDensity":
        """The same density at another capacity."""
        return self.with_rank(capacity.density_rank, generator).resized(capacity.size)

    def sigma(self, x: np.ndarray, chunks: int) -> np.ndarray:
        """Raw density of warped points [n, 3] float32 -> [n]."""
        out = np.empty(len(x), np.float32)
        kernels.density(self.table, self.size, self.values[-1], self._ranks, x, chunks, out)
        return out

    def march(self, space, rays, occupancy, step, displacement, limit, opaque, closed, chunks) -> "Samples":
        """Walk rays through the density."""
        numbers = self.table, self.size, self.values[-1], self._ranks
        return walk(
            kernels.march_density,
            numbers,
            space,
            rays,
            occupancy,
            step,
            displacement,
            limit,
            opaque,
            closed,
            chunks,
        )

    def backward(self, x, starts, ends, sigma, sigma_gradients, to: np.ndarray) -> None:
        """Add dL/d(values) to the chunks' buffers `to` [chunks, len(values)]."""
        kernels.density_backward(
            self.table, self.size, self.values[-1], self._ranks, x, starts, ends, sigma, sigma_gradients, len(to), to
        )

    def add_position_gradients(self, samples: Samples, sigma_gradients, out: np.ndarray, chunks: int) -> None:
        """Add dL/dx to out [n, 3], x the samples' positions in the cube."""
        density_position_gradient(
            self.table,
            self.size,
            self._ranks,
            samples.x,
            samples.starts,
            samples.ends,
            samples.sigma,
            sigma_gradients,
            chunks,
            out,
        )

    def smooth(self, strength: float, to: np.ndarray) -> None:
        """Add the gradient of the planes' total variation (mean squared difference) to buffer `to` [len(values)]."""
        kernels.smoothness_backward(self.table, self.size, self.rank, np.float32(strength / len(self.values)), to)

    def describe(self) -> dict:
        return {"kind": self.kind, "size": [int(s) for s in self.size], "rank": self.rank}

    @classmethod
    def restore(cls, data: dict, values: np.ndarray) -> "VmDensity":
        return cls(np.asarray(data["size"], np.int64), data["rank"], values)


class VmColour:
    """Colour sigmoid(bias + sum_b Y_b(d) head_b . features(x)). values: table, head [3, bands, 3 rank], bias [3]."""

    kind = "vm"

    def __init__(self, size: np.ndarray, rank: int, degree: int, values: np.ndarray) -> None:
        self.size, self.rank, self.degree, self.values = np.asarray(size, np.int64), int(rank), int(degree), values
        self._ranks = (np.int8(0),) * self.rank
        self._head = 3 * BANDS[self.degree] * 3 * self.rank

    @classmethod
    def create(cls, size: np.ndarray, rank: int, degree: int, generator: np.random.Generator) -> "VmColour":
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

    def resized(self, size: np.ndarray) -> "VmColour":
        table = resized_table(self.table, self.size, np.asarray(size), self.rank)
        return VmColour(size, self.rank, self.degree, np.concatenate([table, self.head, self.values[-3:]]))

    def with_rank(self, rank: int, generator: np.random.Generator) -> "VmColour":
        """The same colour with more ranks; the head of a new rank is random, its features zero."""
        if rank <= self.rank:
            return self
        table = _widened_table(self.table, self.size, self.rank, rank, generator)
        bands = BANDS[self.degree]
        head = VmColour.create(np.full(3, 8), rank, self.degree, generator).head.reshape(3, bands, 3, rank)
        head[..., : self.rank] = self.head.reshape(3, bands, 3, self.rank)
        return VmColour(self.size, rank, self.degree, np.concatenate([table, head.ravel(), self.values[-3:]]))

    def grown(self, capacity: Capacity, generator: np.random.Generator) -> "VmColour":
        """The same colour at another capacity."""
        return self.with_rank(capacity.colour_rank, generator).resized(capacity.size)

    def with_degree(self, degree: int) -> "VmColour":
        """The same colour with more (zero) or fewer spherical-harmonic bands."""
        old = self.head.reshape(3, BANDS[self.degree], -1)
        head = np.zeros((3, BANDS[degree], old.shape[2]), np.float32)
        shared = min(old.shape[1], head.shape[1])
        head[:, :shared] = old[:, :shared]
        return VmColour(self.size, self.rank, degree, np.concatenate([self.table, head.ravel(), self.values[-3:]]))

    def colours(self, x, basis, starts, ends, weights, least, chunks) -> np.ndarray:
        """[n, 3] colours in 0..1 of samples with weight > least; others have -1 in the first channel."""
        out = np.empty((len(x), 3), np.float32)
        kernels.colour(
            self.table,
            self.size,
            self._ranks,
            self.head,
            self.values[-3:],
            basis,
            x,
            starts,
            ends,
            weights,
            np.float32(least),
            chunks,
            out,
        )
        return out

    def backward(self, x, basis, starts, ends, colours, colour_gradients, to: np.ndarray) -> None:
        """Add dL/d(values) to the chunks' buffers `to` [chunks, len(values)]."""
        kernels.colour_backward(
            self.table,
            self.size,
            self._ranks,
            self.head,
            basis,
            x,
            starts,
            ends,
            colours,
            colour_gradients,
            len(to),
            to,
        )

    def add_position_gradients(
        self, samples: Samples, basis: np.ndarray, colours: np.ndarray, colour_gradients: np.ndarray, out, chunks: int
    ) -> None:
        """Add dL/dx to out [n, 3], x the samples' positions in the cube."""
        colour_position_gradient(
            self.table,
            self.size,
            self._ranks,
            self.head,
            basis,
            samples.x,
            samples.starts,
            samples.ends,
            colours,
            colour_gradients,
            chunks,
            out,
        )

    def smooth(self, strength: float, to: np.ndarray) -> None:
        """As VmDensity.smooth."""
        kernels.smoothness_backward(self.table, self.size, self.rank, np.float32(strength / len(self.table)), to)

    def describe(self) -> dict:
        return {"kind": self.kind, "size": [int(s) for s in self.size], "rank": self.rank, "degree": self.degree}

    @classmethod
    def restore(cls, data: dict, values: np.ndarray) -> "VmColour":
        return cls(np.asarray(data["size"], np.int64), data["rank"], data["degree"], values)
