"""Hash and voxel grids on a GPU: layout, smoothing, densities."""

import numpy as np
import torch
import triton
from torch import Tensor

from stylerf.fields.hash_grid import Levels
from stylerf.fields.voxel import Grid
from stylerf.kernels.gpu import launch_grids
from stylerf.kernels.gpu.density import HASH, VOXEL
from stylerf.kernels.gpu.launch import GpuSamples


class GpuHashLevels:
    """Levels of fields/hash_levels.py; code, pieces, size: constants for kernels/gpu/density.py and encoders.py."""

    code, pieces, size = HASH.value, 1, (0, 0, 0)

    def __init__(self, levels: Levels, device: torch.device) -> None:
        self.rank, self.length = levels.count * levels.width, levels.length
        self.layout = torch.from_numpy(levels.layout()).to(device)
        self._row, self._cells, self._active = levels.width, levels.cells, levels.active
        self._firsts = [int(first) for first in levels.firsts]
        self._direct = [levels.is_direct(level) for level in range(levels.count)]

    def smooth(self, values: Tensor, strength: float, to: Tensor) -> None:
        """See add_smoothness in fields/hash_density.py; to: [length or more]."""
        strength = strength / self.length
        for level in range(self._active):
            first, end = self._firsts[level : level + 2]
            if self._direct[level]:
                launch_grids.level_smoothness(values, strength, self._cells[level] + 1, first, self._row, to)
            else:
                to[first:end].add_(values[first:end], alpha=strength)


class GpuVoxelGrid:
    """Grid of fields/voxel.py with `row` floats per vertex."""

    code, pieces = VOXEL.value, 1

    def __init__(self, grid: Grid, row: int, device: torch.device) -> None:
        self.size, self.rank = [int(s) for s in grid.size], row
        self.length = grid.rows * row
        self.layout = torch.from_numpy(grid.links).to(device)
        places = np.zeros((1 + np.count_nonzero(grid.kept), 3), np.int32)  # contiguous, unlike argwhere's own
        places[1:] = np.argwhere(grid.kept)
        self.places = torch.from_numpy(places).to(device)

    def smooth(self, values: Tensor, strength: float, to: Tensor) -> None:
        """See VoxelDensity.smooth in fields/voxel.py; to: [length or more]."""
        strength = strength / self.length
        launch_grids.voxel_smoothness(values, self.layout, self.places, self.size, self.rank, strength, to)


class _GpuGridDensity:
    """A hash or voxel density. half: the table is read in half precision and cannot learn."""

    def __init__(self, part, grid: GpuHashLevels | GpuVoxelGrid, device: torch.device, half: bool) -> None:
        self.values = torch.from_numpy(part.values).to(device, copy=True)
        self.groups, self.grid = part.groups(), grid
        self.code, self.size, self.rank, self.layout = grid.code, grid.size, grid.rank, grid.layout
        self.width = triton.next_power_of_2(grid.rank)
        table = self.values[:-1]
        self.table, self.shift = table.half() if half else table, self.values[-1:]

    def sigma(self, points: Tensor) -> Tensor:
        """Raw density [n] of cube points [n, 3]."""
        return launch_grids.grid_density(self, points)

    def smooth(self, strength: float, to: Tensor) -> None:
        """Add the gradient of `strength` times the part's total variation to `to` [len(values)]."""
        self.grid.smooth(self.values, strength, to)


class GpuHashDensity(_GpuGridDensity):
    """HashDensity of fields/hash_density.py on a GPU."""

    def __init__(self, part, device: torch.device, half: bool = False) -> None:
        super().__init__(part, GpuHashLevels(part.levels, device), device, half)

    def backward(self, samples: GpuSamples, sigma_gradients: Tensor, to: Tensor) -> None:
        """Add dL/d(values) to `to` [len(values)]."""
        launch_grids.hash_density_backward(self, samples, sigma_gradients, to)


class GpuVoxelDensity(_GpuGridDensity):
    """VoxelDensity of fields/voxel.py on a GPU."""

    def __init__(self, part, device: torch.device, half: bool = False) -> None:
        super().__init__(part, GpuVoxelGrid(part.grid, 1, device), device, half)

    def backward(self, samples: GpuSamples, sigma_gradients: Tensor, to: Tensor) -> None:
        """Add dL/d(values) to `to` [len(values)]."""
        launch_grids.voxel_density_backward(self, samples, sigma_gradients, to)
