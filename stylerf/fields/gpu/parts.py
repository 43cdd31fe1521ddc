"""The parts of a field on a GPU: their values as tensors, the Triton kernels behind them.

half: a table is read in half precision and cannot learn.
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
from stylerf.kernels.gpu import launch
from stylerf.kernels.gpu.ray_samples import GpuSamples
from stylerf.kernels.gpu.tables import HASH, VM, VOXEL

# -- tables: code, pieces, size, rank and layout as kernels/gpu/tables.py reads them -----------------------------------


class GpuPlanes:
    """Planes and lines of fields/vm.py."""

    code, pieces = VM.value, 3

    def __init__(self, size: np.ndarray, rank: int, device: torch.device) -> None:
        self.size, self.rank, self.length = [int(s) for s in size], rank, table_length(size, rank)
        self.layout = torch.zeros(1, dtype=torch.int32, device=device)  # not read, but kernels need a pointer
        self.width = launch.width_of(rank)

    def smooth(self, values: Tensor, strength: float, to: Tensor) -> None:
        """Add the gradient of `strength` times the total variation to `to` [length or more]."""
        launch.plane_smoothness(values, self.size, self.rank, strength / self.length, to)


class GpuHashLevels:
    """Levels of fields/hash_grid.py."""

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
                launch.level_smoothness(values, strength, self._cells[level] + 1, first, self._row, to)
            else:
                to[first:end].add_(values[first:end], alpha=strength)


class GpuVoxelGrid:
    """Grid of fields/voxel.py with `row` floats per vertex."""

    code, pieces = VOXEL.value, 1

    def __init__(self, grid: Grid, row: int, device: torch.device) -> None:
        self.size, self.rank, self.length = [int(s) for s in grid.size], row, grid.rows * row
        self.layout = torch.from_numpy(grid.links).to(device)
        self.width = triton.next_power_of_2(row)
        places = np.zeros((1 + np.count_nonzero(grid.kept), 3), np.int32)  # contiguous, unlike argwhere's own
        places[1:] = np.argwhere(grid.kept)
        self.places = torch.from_numpy(places).to(device)

    def smooth(self, values: Tensor, strength: float, to: Tensor) -> None:
        """See VoxelDensity.smooth in fields/voxel.py; to: [length or more]."""
        launch.voxel_smoothness(values, self.layout, self.places, self.size, self.rank, strength / self.length, to)


GpuTable = GpuPlanes | GpuHashLevels | GpuVoxelGrid
TABLES: dict[str, Callable[..., GpuTable]] = {
    "vm": lambda part, row, device: GpuPlanes(part.size, part.rank, device),
    "hash": lambda part, row, device: GpuHashLevels(part.levels, device),
    "voxel": lambda part, row, device: GpuVoxelGrid(part.grid, row, device),
}


class GpuPart:
    """A part of fields/protocol.py on a GPU. moves: whether there is a kernel for its gradient to positions."""

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
        self.table, self.shift = table.half() if half else table, self.values[-1:]

    def sigma(self, points: Tensor) -> Tensor:
        """Raw density [n] of cube points [n, 3]."""
        return launch.density_at(self, points)

    def backward(self, samples: GpuSamples, sigma_gradients: Tensor, to: Tensor) -> None:
        """Add dL/d(values) to `to` [len(values)]."""
        launch.density_backward(self, samples, sigma_gradients, to)

    def add_position_gradients(self, samples: GpuSamples, sigma_gradients: Tensor, out: Tensor) -> None:
        """Add dL/dx to out [room, 3], x the samples' positions in the cube."""
        raise NotImplementedError

    def smooth(self, strength: float, to: Tensor) -> None:
        self.grid.smooth(self.values, strength, to)


class GpuVmDensity(GpuDensity):
    moves = True

    def add_position_gradients(self, samples: GpuSamples, sigma_gradients: Tensor, out: Tensor) -> None:
        launch.add_density_slopes(self, samples, sigma_gradients, out)

    def smooth(self, strength: float, to: Tensor) -> None:
        """See VmDensity.smooth."""
        launch.plane_smoothness(self.values, self.size, self.rank, strength / len(self.values), to)


# -- colors -----------------------------------------------------------------------------------------------------------


class GpuColor(GpuPart):
    """A color part. directions: [rays, 3]; a hash color does not read them."""

    def visible_colors(self, samples: GpuSamples, directions: Tensor | None, weight_threshold: float) -> Tensor:
        """Color the samples of at least weight_threshold times their ray's largest weight.

        Returns:
            [room, 3] in 0..1; -1 in the first channel of all other samples.
        """
        raise NotImplementedError

    def backward(self, samples: GpuSamples, directions, colors, color_gradients, to: Tensor) -> None:
        """Add dL/d(values) to `to` [len(values)]."""
        raise NotImplementedError

    def add_position_gradients(self, samples: GpuSamples, directions, colors, color_gradients, out: Tensor) -> None:
        """Add dL/dx to out [room, 3]."""
        raise NotImplementedError


class GpuEncodedColor(GpuColor):
    """EncodedColor of fields/encoded_color.py."""

    def __init__(self, part, device: torch.device, half: bool = False) -> None:
        super().__init__(part, device)
        self._read(TABLES[part.features.kind](part.features, part.features.width, device), part.head.kind, part, half)

    def _read(self, grid: GpuTable, head: str, part, half: bool) -> None:
        self.grid, self.code, self.pieces = grid, grid.code, grid.pieces
        self.size, self.rank, self.layout = grid.size, grid.rank, grid.layout
        self.head, self.bands, self.hidden = head, BANDS[part.degree], HIDDEN if head == "mlp" else 0
        table, numbers = self.values[: grid.length], self.values[grid.length :]
        self.table = table.half() if half else table
        self.numbers = numbers if len(numbers) else self.values  # the harmonic head has none, but needs a pointer

    def visible_colors(self, samples: GpuSamples, directions: Tensor | None, weight_threshold: float) -> Tensor:
        return launch.headed_colors(self, samples, directions, weight_threshold)

    def backward(self, samples: GpuSamples, directions, colors, color_gradients, to: Tensor) -> None:
        launch.headed_colors_backward(self, samples, directions, colors, color_gradients, to)

    def smooth(self, strength: float, to: Tensor) -> None:
        self.grid.smooth(self.values, strength, to)


class GpuVmColor(GpuEncodedColor):
    """VmColor of fields/vm.py: a linear head on vm features."""

    moves = True

    def __init__(self, part, device: torch.device, half: bool = False) -> None:
        GpuPart.__init__(self, part, device)
        self._read(TABLES["vm"](part, 0, device), "linear", part, half)

    def add_position_gradients(self, samples: GpuSamples, directions, colors, color_gradients, out: Tensor) -> None:
        launch.add_vm_color_slopes(self, samples, directions, colors, color_gradients, out)


class GpuHashColor(GpuColor):
    """HashColor of fields/hash_grid.py."""

    moves = True

    def __init__(self, part, device: torch.device, half: bool = False) -> None:
        super().__init__(part, device)
        self.levels, self.layout = part.levels, torch.from_numpy(part.layout).to(device)
        self.table = self.values.half() if half else self.values

    def visible_colors(self, samples: GpuSamples, directions: Tensor | None, weight_threshold: float) -> Tensor:
        return launch.hash_colors(self, samples, weight_threshold)

    def backward(self, samples: GpuSamples, directions, colors, color_gradients, to: Tensor) -> None:
        launch.hash_colors_backward(self, samples, colors, color_gradients, to)

    def add_position_gradients(self, samples: GpuSamples, directions, colors, color_gradients, out: Tensor) -> None:
        launch.add_hash_color_slopes(self, samples, colors, color_gradients, out)

    def smooth(self, strength: float, to: Tensor) -> None:
        """See HashColor.smooth."""
        to.add_(self.values, alpha=strength / len(self.values))


class GpuRegionColor(GpuHashColor):
    """RegionColor of fields/region_color.py, over a base of any kind; values: the region's own."""

    moves = False

    def __init__(self, part, device: torch.device, half: bool = False) -> None:
        super().__init__(part.own, device, half)
        self.base = COLOR_KINDS[part.base.kind](part.base, device, half)
        self.marked, self.cells = marked_cells(part.marked, device), part.cells
        self.box = torch.from_numpy(np.array([*part.low, 1 / part.side], np.float32)).to(device)

    def visible_colors(self, samples: GpuSamples, directions: Tensor | None, weight_threshold: float) -> Tensor:
        out = self.base.visible_colors(samples, directions, weight_threshold)
        launch.region_colors(self, samples, out)
        return out

    def backward(self, samples: GpuSamples, directions, colors, color_gradients, to: Tensor) -> None:
        launch.region_colors_backward(self, samples, colors, color_gradients, to)


DENSITY_KINDS: dict[str, type[GpuDensity]] = {"vm": GpuVmDensity, "hash": GpuDensity, "voxel": GpuDensity}
COLOR_KINDS: dict[str, type[GpuColor]] = {
    "vm": GpuVmColor,
    "hash": GpuHashColor,
    "headed": GpuEncodedColor,
    "patch": GpuRegionColor,
}


def marked_cells(marked: np.ndarray, device: torch.device) -> Tensor:
    """Return cells [s, s, s] bool as the kernels read them: uint8 [s^3]."""
    return torch.from_numpy(np.ascontiguousarray(marked).reshape(-1).astype(np.uint8)).to(device)
