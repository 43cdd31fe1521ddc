"""The parts of a field on a GPU: their values as tensors, backed by Triton kernels.

half: the table is stored in half precision and cannot be trained.
"""

from collections.abc import Callable

import numpy as np
import torch
import triton
from torch import Tensor

from stylerf.fields.color_heads import HIDDEN
from stylerf.fields.hash_grid import Levels
from stylerf.fields.vm import table_length
from stylerf.fields.voxel import Grid
from stylerf.geometry.spherical_harmonics import BANDS
from stylerf.kernels.gpu import color_heads, deformation, hash_color, hash_levels, regions, tables, vm, voxel
from stylerf.kernels.gpu.launch import POINTS, SAMPLES, over, over_samples, width_of
from stylerf.kernels.gpu.ray_samples import GpuSamples
from stylerf.kernels.gpu.tables import HASH, VM, VOXEL

# With four warps, the MLP's backward on hash features spills 4.6 KB per thread to local memory; with eight, 0.2 KB
# (compiled for capability 9.0).
HEAD_WARPS = 8
HEADS = {
    "linear": (color_heads.LINEAR.value, color_heads.linear_backward_kernel),
    "harmonic": (color_heads.HARMONIC.value, color_heads.harmonic_backward_kernel),
    "mlp": (color_heads.MLP.value, color_heads.mlp_backward_kernel),
}

# -- tables: code, pieces, size, rank and layout as kernels/gpu/tables.py reads them -----------------------------------


class GpuPlanes:
    """Planes and lines; see fields/vm.py."""

    code, pieces = VM.value, 3

    def __init__(self, size: np.ndarray, rank: int, device: torch.device) -> None:
        self.size, self.rank, self.length = [int(s) for s in size], rank, table_length(size, rank)
        self.layout = torch.zeros(1, dtype=torch.int32, device=device)  # not read, but kernels need a pointer
        self.width = width_of(rank)

    def smooth(self, values: Tensor, strength: float, to: Tensor, count: int = 0) -> None:
        """Add the gradient of strength/2 times the mean squared difference of texels to `to` [length or more].

        count: divisor of the mean; 0: the table's length.
        """
        begin, strength = 0, strength / (count or self.length)
        for a, b in ((1, 2), (2, 0), (0, 1)):
            rows, columns = self.size[a], self.size[b]
            arguments = values, to, strength, rows, columns, begin
            over(vm.smoothness_kernel, rows * columns, SAMPLES, *arguments, RANK=self.rank, WIDTH=self.width)
            begin += rows * columns


class GpuHashLevels:
    """Hash-grid levels; see fields/hash_grid.py."""

    code, pieces, size = HASH.value, 1, [0, 0, 0]

    def __init__(self, levels: Levels, device: torch.device) -> None:
        self.rank, self.length = levels.count * levels.width, levels.length
        self.layout = torch.from_numpy(levels.layout()).to(device)
        self.width = triton.next_power_of_2(self.rank)
        self._row, self._cells, self._active = levels.width, levels.cells, levels.active
        self._firsts = [int(first) for first in levels.firsts]
        self._direct = [levels.is_direct(level) for level in range(levels.count)]

    def smooth(self, values: Tensor, strength: float, to: Tensor) -> None:
        """See add_smoothness in fields/hash_grid.py; to: [length or more]."""
        strength = strength / self.length
        for level in range(self._active):
            first, end = self._firsts[level : level + 2]
            if self._direct[level]:
                vertices = self._cells[level] + 1
                arguments = values, to, strength, vertices, int(first)
                over(hash_levels.smoothness_kernel, vertices**3 * self._row, POINTS, *arguments, ROW=self._row)
            else:
                to[first:end].add_(values[first:end], alpha=strength)


class GpuVoxelGrid:
    """Voxel grid with `row` floats per vertex; see fields/voxel.py."""

    code, pieces = VOXEL.value, 1

    def __init__(self, grid: Grid, row: int, device: torch.device) -> None:
        self.size, self.rank, self.length = [int(s) for s in grid.size], row, grid.rows * row
        self.layout = torch.from_numpy(grid.links).to(device)
        self.width = triton.next_power_of_2(row)
        places = np.zeros((1 + np.count_nonzero(grid.kept), 3), np.int32)  # contiguous, unlike argwhere's result
        places[1:] = np.argwhere(grid.kept)  # row 0: the shared block, which has no position
        self.places = torch.from_numpy(places).to(device)

    def smooth(self, values: Tensor, strength: float, to: Tensor) -> None:
        """See VoxelDensity.smooth in fields/voxel.py; to: [length or more]."""
        rows = 64 * len(self.places)
        arguments = values, self.layout, self.places, to, strength / self.length, rows, *self.size
        over(voxel.smoothness_kernel, rows, SAMPLES, *arguments, ROW=self.rank, WIDTH=self.width)


GpuTable = GpuPlanes | GpuHashLevels | GpuVoxelGrid
TABLES: dict[str, Callable[..., GpuTable]] = {
    "vm": lambda part, row, device: GpuPlanes(part.size, part.rank, device),
    "hash": lambda part, row, device: GpuHashLevels(part.levels, device),
    "voxel": lambda part, row, device: GpuVoxelGrid(part.grid, row, device),
}


class GpuPart:
    """GPU counterpart of Part (fields/protocol.py). moves: whether it can differentiate with respect to positions."""

    moves = False

    def __init__(self, part, device: torch.device, half: bool = False) -> None:
        self.values = torch.from_numpy(part.values).to(device, copy=True)
        self.groups = [group for group in part.groups() if group[0] < group[1]]

    def smooth(self, strength: float, to: Tensor) -> None:
        """Add the gradient of `strength` times the part's total variation to `to` [len(values)]."""
        raise NotImplementedError


# -- densities --------------------------------------------------------------------------------------------------------


class GpuDensity(GpuPart):
    """A TableDensity of any kind."""

    def __init__(self, part, device: torch.device, half: bool = False) -> None:
        super().__init__(part, device)
        self.grid = grid = TABLES[part.kind](part, 1, device)
        self.code, self.size, self.rank = grid.code, grid.size, grid.rank
        self.layout, self.width = grid.layout, grid.width
        table = self.values[:-1]
        # The shift stays a pointer: reading it as a number would synchronize.
        self.table, self.shift = table.half() if half else table, self.values[-1:]

    def sigma(self, points: Tensor) -> Tensor:
        """Return raw density [n] at cube points [n, 3]."""
        out, n = torch.empty(len(points), device=points.device), len(points)
        arguments = self.table, self.layout, self.shift, points, out, n, *self.size
        over(tables.density_kernel, n, POINTS, *arguments, DENSITY=self.code, RANK=self.rank, WIDTH=self.width)
        return out

    def backward(self, samples: GpuSamples, sigma_gradients: Tensor, to: Tensor) -> None:
        """Add dL/d(values) to `to` [len(values)]."""
        s = samples
        over_samples(
            tables.density_backward_kernel, s, self.table, self.layout, s.x, s.sigma, sigma_gradients, s.total, to,
            to[-1:], *self.size, DENSITY=self.code, RANK=self.rank, WIDTH=self.width,
        )  # fmt: skip

    def add_position_gradients(self, samples: GpuSamples, sigma_gradients: Tensor, out: Tensor) -> None:
        """Add dL/dx to out [capacity, 3], x: sample positions in the cube; only for kinds with `moves`."""
        s = samples
        over_samples(
            deformation.density_position_kernel, s, self.table, self.layout, s.x, s.sigma, sigma_gradients, s.total,
            out, *self.size, DENSITY=self.code, RANK=self.rank, WIDTH=self.width,
        )  # fmt: skip

    def smooth(self, strength: float, to: Tensor) -> None:
        self.grid.smooth(self.values, strength, to)


class GpuHashDensity(GpuDensity):
    moves = True


class GpuVmDensity(GpuDensity):
    grid: GpuPlanes
    moves = True

    def smooth(self, strength: float, to: Tensor) -> None:
        self.grid.smooth(self.values, strength, to, len(self.values))


# -- colors -----------------------------------------------------------------------------------------------------------


class GpuColor(GpuPart):
    """A color part. directions: [rays, 3]; ignored by hash colors."""

    def visible_colors(self, samples: GpuSamples, directions: Tensor | None, weight_threshold: float) -> Tensor:
        """Color samples whose weight is at least weight_threshold times their ray's largest weight.

        Returns:
            [capacity, 3] in 0..1; all other samples have -1 in the first channel.
        """
        raise NotImplementedError

    def backward(self, samples: GpuSamples, directions, colors, color_gradients, to: Tensor) -> None:
        """Add dL/d(values) to `to` [len(values)]."""
        raise NotImplementedError

    def add_position_gradients(self, samples: GpuSamples, directions, colors, color_gradients, out: Tensor) -> None:
        """Add dL/dx to out [capacity, 3]."""
        raise NotImplementedError


class GpuEncodedColor(GpuColor):
    """GPU counterpart of EncodedColor (fields/encoded_color.py)."""

    def __init__(self, part, device: torch.device, half: bool = False) -> None:
        super().__init__(part, device)
        self._read(TABLES[part.features.kind](part.features, part.features.width, device), part.head.kind, part, half)

    def _read(self, grid: GpuTable, head: str, part, half: bool) -> None:
        self.grid, self.size, self.rank, self.layout = grid, grid.size, grid.rank, grid.layout
        self.head, self.bands = head, BANDS[part.degree]
        self.outputs = max(16, triton.next_power_of_2(3 * self.bands))  # columns of a tile of the head's outputs
        plain = head == "linear" and grid.code == VM.value  # few registers: Triton's default number of warps
        self._constants = {
            "ENCODER": grid.code, "PIECES": grid.pieces, "RANK": grid.rank, "WIDTH": width_of(grid.rank),
            "BANDS": self.bands, "UNITS": HIDDEN if head == "mlp" else self.outputs,
            "num_warps": 4 if plain else HEAD_WARPS,
        }  # fmt: skip
        table, numbers = self.values[: grid.length], self.values[grid.length :]
        self.table = table.half() if half else table
        self.numbers = numbers if len(numbers) else self.values  # the harmonic head has none, but needs a pointer

    def visible_colors(self, samples: GpuSamples, directions: Tensor | None, weight_threshold: float) -> Tensor:
        s, out = samples, torch.empty((samples.capacity, 3), device=samples.x.device)
        over_samples(
            color_heads.color_kernel, s, self.table, self.layout, self.numbers, s.x, directions, s.ray_of, s.weights,
            s.largest, float(weight_threshold), s.total, out, *self.size, HEAD=HEADS[self.head][0], **self._constants,
        )  # fmt: skip
        return out

    def backward(self, samples: GpuSamples, directions, colors, color_gradients, to: Tensor) -> None:
        s = samples
        over_samples(
            HEADS[self.head][1], s, self.table, self.layout, self.numbers, s.x, directions, s.ray_of, colors,
            color_gradients, s.total, to, to[len(self.table) :], *self.size, **self._constants,
        )  # fmt: skip

    def smooth(self, strength: float, to: Tensor) -> None:
        self.grid.smooth(self.values, strength, to)


class GpuVmColor(GpuEncodedColor):
    """GPU counterpart of VmColor (fields/vm.py): a linear head on vm features."""

    moves = True

    def __init__(self, part, device: torch.device, half: bool = False) -> None:
        GpuPart.__init__(self, part, device)
        self._read(TABLES["vm"](part, 0, device), "linear", part, half)

    def add_position_gradients(self, samples: GpuSamples, directions, colors, color_gradients, out: Tensor) -> None:
        s = samples
        over_samples(
            deformation.vm_color_position_kernel, s, self.table, self.numbers, s.x, directions, s.ray_of, colors,
            color_gradients, s.total, out, *self.size,
            RANK=self.rank, WIDTH=width_of(self.rank), BANDS=self.bands, OUTPUTS=self.outputs,
        )  # fmt: skip


class GpuHashColor(GpuColor):
    """GPU counterpart of HashColor (fields/hash_grid.py)."""

    moves = True

    def __init__(self, part, device: torch.device, half: bool = False) -> None:
        super().__init__(part, device)
        self.levels, self.layout = part.levels, torch.from_numpy(part.layout).to(device)
        self.table = self.values.half() if half else self.values

    def visible_colors(self, samples: GpuSamples, directions: Tensor | None, weight_threshold: float) -> Tensor:
        s, out = samples, torch.empty((samples.capacity, 3), device=samples.x.device)
        arguments = s.x, s.ray_of, s.weights, s.largest, float(weight_threshold), s.total, out
        over_samples(hash_color.color_kernel, s, self.table, self.layout, *arguments, LEVELS=self.levels)
        return out

    def backward(self, samples: GpuSamples, directions, colors, color_gradients, to: Tensor) -> None:
        arguments = samples.x, colors, color_gradients, samples.total, to
        over_samples(hash_color.color_backward_kernel, samples, self.layout, *arguments, LEVELS=self.levels)

    def add_position_gradients(self, samples: GpuSamples, directions, colors, color_gradients, out: Tensor) -> None:
        arguments = self.table, self.layout, samples.x, colors, color_gradients, samples.total, out
        over_samples(deformation.hash_color_position_kernel, samples, *arguments, LEVELS=self.levels)

    def smooth(self, strength: float, to: Tensor) -> None:
        """See HashColor.smooth."""
        to.add_(self.values, alpha=strength / len(self.values))


class GpuRegionColor(GpuHashColor):
    """GPU counterpart of RegionColor (fields/region_color.py), over a base of any kind; values: the region's own."""

    moves = False

    def __init__(self, part, device: torch.device, half: bool = False) -> None:
        super().__init__(part.own, device, half)
        self.base = COLOR_KINDS[part.base.kind](part.base, device, half)
        self.marked, self.cells = marked_cells(part.marked, device), part.cells
        self.box = torch.from_numpy(np.array([*part.low, 1 / part.side], np.float32)).to(device)

    def visible_colors(self, samples: GpuSamples, directions: Tensor | None, weight_threshold: float) -> Tensor:
        out = self.base.visible_colors(samples, directions, weight_threshold)
        self.add_logits(samples, out)
        return out

    def add_logits(self, samples: GpuSamples, colors: Tensor) -> None:
        """Add the region's logits to the base's colors [capacity, 3], in place."""
        arguments = self.table, self.layout, self.marked, self.cells, self.box, samples.x, samples.total, colors
        over_samples(regions.color_kernel, samples, *arguments, LEVELS=self.levels)

    def backward(self, samples: GpuSamples, directions, colors, color_gradients, to: Tensor) -> None:
        s = samples
        arguments = self.layout, self.marked, self.cells, self.box, s.x, colors, color_gradients, s.total, to
        over_samples(regions.color_backward_kernel, s, *arguments, LEVELS=self.levels)


DENSITY_KINDS: dict[str, type[GpuDensity]] = {"vm": GpuVmDensity, "hash": GpuHashDensity, "voxel": GpuDensity}
COLOR_KINDS: dict[str, type[GpuColor]] = {
    "vm": GpuVmColor,
    "hash": GpuHashColor,
    "headed": GpuEncodedColor,
    "patch": GpuRegionColor,
}


def marked_cells(marked: np.ndarray, device: torch.device) -> Tensor:
    """Return cells [s, s, s] bool in the kernels' layout: uint8 [s^3]."""
    return torch.from_numpy(np.ascontiguousarray(marked).reshape(-1).astype(np.uint8)).to(device)
