"""How the kernels of a deformation are launched; see launch.py. Nothing here waits for the device."""

import torch
import triton
from torch import Tensor

from stylerf.kernels.gpu import deformation, interpreted
from stylerf.kernels.gpu.launch import (
    SAMPLES,
    STAGES,
    GpuSamples,
    outputs_of,
    persistent_grid,
    width_of,
)

CELLS = 1024 if interpreted() else 32  # to a program, each of 32 lanes


def add_density_slopes(density, samples: GpuSamples, sigma_gradients: Tensor, out: Tensor) -> None:
    """Add dL/dx of a vm density to out [room, 3]."""
    deformation.density_position_kernel[persistent_grid(out.device, samples.room, SAMPLES)](
        density.table, samples.x, samples.sigma, sigma_gradients, samples.total, out, *density.size,
        RANK=density.rank, WIDTH=width_of(density.rank), BLOCK=SAMPLES, num_stages=STAGES,
    )  # fmt: skip


def add_vm_color_slopes(color, samples: GpuSamples, directions, colors, color_gradients, out: Tensor) -> None:
    """Add dL/dx of vm colors to out [room, 3]."""
    deformation.vm_color_position_kernel[persistent_grid(out.device, samples.room, SAMPLES)](
        color.table, color.head, samples.x, directions, samples.ray_of, colors, color_gradients, samples.total, out,
        *color.size,
        RANK=color.rank, WIDTH=width_of(color.rank), BANDS=color.bands, OUTPUTS=outputs_of(color.bands),
        BLOCK=SAMPLES, num_stages=STAGES,
    )  # fmt: skip


def add_hash_color_slopes(color, samples: GpuSamples, colors, color_gradients, out: Tensor) -> None:
    """Add dL/dx of a hash grid's colors to out [room, 3]."""
    deformation.hash_color_position_kernel[persistent_grid(out.device, samples.room, SAMPLES)](
        color.table, color.layout, samples.x, colors, color_gradients, samples.total, out,
        LEVELS=color.levels, BLOCK=SAMPLES, num_stages=STAGES,
    )  # fmt: skip


def displacement_backward(
    code: int, space: Tensor, origins, directions, samples: GpuSamples, position_gradients, vertices: int, to: Tensor
) -> None:
    """Add dL/dD to `to`, flat [vertices^3, 3], from dL/dx' [room, 3]; code, space: as in GpuMarchInputs."""
    deformation.displacement_backward_kernel[persistent_grid(to.device, samples.room, SAMPLES)](
        space, origins, directions, samples.ray_of, samples.t, samples.deltas, samples.x, position_gradients,
        samples.total, to, vertices, KIND=code, BLOCK=SAMPLES, num_stages=STAGES,
    )  # fmt: skip


def displaced_cells(distances: Tensor, cells: int, reach: int, displacement: Tensor, vertices: int) -> Tensor:
    """[cells, cells, cells] bool: cells of x with x + D(x) in a cell of distance 0; displacement flat [vertices^3 * 3].

    reach: cells that D moves anything by at most, and one more.
    """
    occupied = torch.empty(cells**3, dtype=torch.uint8, device=distances.device)
    deformation.displaced_cells_kernel[(triton.cdiv(cells**3, CELLS),)](
        distances, cells, reach, displacement, vertices, occupied, BLOCK=CELLS
    )
    return occupied.view(cells, cells, cells) > 0
