"""Launches of the kernels of local edits; see launch.py. Nothing here waits for the device."""

import torch
import triton
from torch import Tensor

from stylerf.kernels.gpu import compositing, pixel_rays, region_color, regions
from stylerf.kernels.gpu import hash_color as hash_kernels
from stylerf.kernels.gpu.launch import POINTS, SAMPLES, STAGES, GpuSamples, persistent_grid


def region_colors(part, samples: GpuSamples, colors: Tensor) -> None:
    """Add the region's logits to the base's colors [room, 3], in place. part: a GpuRegionColor."""
    region_color.color_kernel[persistent_grid(colors.device, samples.room, SAMPLES)](
        part.table, part.layout, part.marked, part.cells, part.box, samples.x, samples.total, colors,
        LEVELS=part.levels, BLOCK=SAMPLES, num_stages=STAGES,
    )  # fmt: skip


def region_colors_backward(part, samples: GpuSamples, colors: Tensor, color_gradients, to: Tensor) -> None:
    """Add dL/d(values) to `to` [len(values)]."""
    region_color.color_backward_kernel[persistent_grid(to.device, samples.room, SAMPLES)](
        part.layout, part.marked, part.cells, part.box, samples.x, colors, color_gradients, samples.total, to,
        LEVELS=part.levels, BLOCK=SAMPLES, num_stages=STAGES,
    )  # fmt: skip


def zero_outside(marked: Tensor, cells: int, samples: GpuSamples, values: Tensor) -> None:
    """Set values [room] to 0 for samples outside the marked cells (uint8 [cells^3])."""
    regions.keep_kernel[persistent_grid(values.device, samples.room, SAMPLES)](
        marked, cells, samples.x, samples.total, values, BLOCK=SAMPLES, num_stages=STAGES
    )


def ends_inside(marked: Tensor, cells: int, samples: GpuSamples) -> Tensor:
    """Return [rays, 6]: sum w, then sums over marked cells of w, w t and w x."""
    n = len(samples.starts)
    out = torch.empty((n, 6), device=samples.x.device)
    if n:
        regions.ends_kernel[(triton.cdiv(n, POINTS),)](
            marked, cells, samples.x, samples.t, samples.weights, samples.starts, samples.ends, out, n, BLOCK=POINTS
        )
    return out


def rays_of_pixels(bank, chosen: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return (origins, directions [n, 3], straight rgba [n, 4]) of pixels [n] int64, numbered across all views."""
    n = len(chosen)
    origins, directions = (torch.empty((n, 3), device=chosen.device) for _ in range(2))
    wanted = torch.empty((n, 4), device=chosen.device)
    if n:
        pixel_rays.rays_kernel[(triton.cdiv(n, POINTS),)](
            chosen, n, bank.view_ends, bank.view_sizes, bank.views, bank.widths, bank.intrinsics, bank.poses,
            bank.bytes, bank.codes, origins, directions, wanted,
            CHANNELS=bank.channels, STEPS=max(1, (bank.views - 1).bit_length()), BLOCK=POINTS,
        )  # fmt: skip
    return origins, directions, wanted


def tuning_loss(
    out: Tensor, wanted: Tensor, depth: Tensor, samples: GpuSamples, level: float, scale: float, depth_scale: float,
    sums: Tensor,
) -> Tensor:  # fmt: skip
    """Return dL/d(out) [rays, 5] and add to sums [5]; see tuning_loss_kernel. depth [m]: of the first m rays."""
    gradients, edited = torch.empty_like(out), len(depth)
    if len(out):
        compositing.tuning_loss_kernel[(triton.cdiv(len(out), POINTS),)](
            out, wanted, depth if edited else out, samples.counts, samples.starts, samples.ends, float(level),
            float(scale), float(depth_scale), edited, gradients, sums, len(out), BLOCK=POINTS,
        )  # fmt: skip
    return gradients


def rows(table: Tensor, layout: Tensor, levels: int, points: Tensor) -> Tensor:
    """[n, 4 levels]: a hash grid's levels side by side at points [n, 3] in 0..1."""
    n = len(points)
    out = torch.empty((n, 4 * levels), device=points.device)
    if n:
        hash_kernels.rows_kernel[(triton.cdiv(n, SAMPLES),)](
            table, layout, points, out, n, LEVELS=levels, BLOCK=SAMPLES, num_stages=STAGES
        )
    return out


def rows_backward(layout: Tensor, levels: int, points: Tensor, gradients: Tensor, to: Tensor) -> None:
    """Add dL/d(table), from dL/d(rows) [n, 4 levels], to `to`."""
    n = len(points)
    if n:
        hash_kernels.rows_backward_kernel[(triton.cdiv(n, SAMPLES),)](
            layout, points, gradients, to, n, LEVELS=levels, BLOCK=SAMPLES, num_stages=STAGES
        )
