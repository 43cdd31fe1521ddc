"""How the kernels of hash grids and voxel grids as densities are launched, and those of their smoothness."""

import torch
import triton
from torch import Tensor

from stylerf.kernels.gpu import density as density_kernels
from stylerf.kernels.gpu import hash_density as hash_kernels
from stylerf.kernels.gpu import voxel as voxel_kernels
from stylerf.kernels.gpu.launch import POINTS, SAMPLES, STAGES, GpuSamples, persistent_grid


def grid_density(density, points: Tensor) -> Tensor:
    """Raw density [n] of cube points [n, 3]. density: has table, layout, shift, size, code, rank and width."""
    out = torch.empty(len(points), device=points.device)
    if len(points):
        density_kernels.density_kernel[(triton.cdiv(len(points), POINTS),)](
            density.table, density.layout, density.shift, points, out, len(points), *density.size,
            DENSITY=density.code, RANK=density.rank, WIDTH=density.width, BLOCK=POINTS,
        )  # fmt: skip
    return out


def hash_density_backward(density, samples: GpuSamples, sigma_gradients: Tensor, to: Tensor) -> None:
    """Add dL/d(values) to `to` [len(values)]: levels, shift."""
    hash_kernels.density_backward_kernel[persistent_grid(to.device, samples.room, SAMPLES)](
        density.layout, samples.x, samples.sigma, sigma_gradients, samples.total, to, to[-1:],
        LEVELS=density.rank, WIDTH=density.width, BLOCK=SAMPLES, num_stages=STAGES,
    )  # fmt: skip


def voxel_density_backward(density, samples: GpuSamples, sigma_gradients: Tensor, to: Tensor) -> None:
    """Add dL/d(values) to `to` [len(values)]: table, shift."""
    voxel_kernels.density_backward_kernel[persistent_grid(to.device, samples.room, SAMPLES)](
        density.layout, samples.x, samples.sigma, sigma_gradients, samples.total, to, to[-1:], *density.size,
        BLOCK=SAMPLES, num_stages=STAGES,
    )  # fmt: skip


def level_smoothness(table: Tensor, strength: float, vertices: int, first: int, row: int, to: Tensor) -> None:
    """Add the gradient of strength/2 times the summed squared differences of neighbors of one direct level to `to`.

    vertices: of the level, a side; first: its first float; row: floats at a vertex.
    """
    hash_kernels.smoothness_kernel[(triton.cdiv(vertices**3 * row, POINTS),)](
        table, to, float(strength), vertices, first, ROW=row, BLOCK=POINTS
    )


def voxel_smoothness(table: Tensor, links: Tensor, places: Tensor, size, row: int, strength: float, to: Tensor) -> None:
    """Add the gradient of strength/2 times the summed squared differences of kept neighbors to `to`.

    places: int32 [blocks of the table, 3]; row: floats at a vertex.
    """
    rows = 64 * len(places)
    voxel_kernels.smoothness_kernel[(triton.cdiv(rows, SAMPLES),)](
        table, links, places, to, float(strength), rows, *size,
        ROW=row, WIDTH=triton.next_power_of_2(row), BLOCK=SAMPLES,
    )  # fmt: skip
