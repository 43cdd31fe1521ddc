"""Kernel launches: grids, block sizes, and everything not launched by a field's parts (fields/gpu/parts.py).

Nothing here synchronizes with the device, unless noted.
"""

from typing import Any

import torch
import triton
from torch import Tensor

from stylerf.kernels.cpu.adam import AdamRates
from stylerf.kernels.gpu import adam as optimizer
from stylerf.kernels.gpu import compositing, deformation, hash_color, interpreted, march, pixel_rays, regions
from stylerf.kernels.gpu.ray_samples import GpuAdamState, GpuMarchInputs, GpuPhotos, GpuRays, GpuSamples, RayDraw

# Rays or samples per program. Marches diverge, so that few rays share a program; the interpreter pays per program.
RAYS, SAMPLES, POINTS, RUNS = (256, 512, 1024, 4096) if interpreted() else (32, 64, 128, 128)
CELLS = 1024 if interpreted() else 32  # per program, each of 32 lanes
# No software pipeline: it would copy the gathered rows through 170 KB of shared memory, more than most GPUs have.
STAGES = 1
PROGRAMS_PER_PROCESSOR = 8  # of kernels that traverse a list whose length only the device knows


def width_of(rank: int) -> int:
    """Return the number of columns in a tile of rows; tl.dot needs at least sixteen."""
    return max(16, triton.next_power_of_2(rank))


def persistent_grid(device: torch.device, most: int, block: int) -> tuple[int]:
    """Return enough programs to occupy the device, for lists of at most `most` entries."""
    if device.type != "cuda":
        return (min(2, max(1, triton.cdiv(most, block))),)
    processors = torch.cuda.get_device_properties(device).multi_processor_count
    return (max(1, min(processors * PROGRAMS_PER_PROCESSOR, triton.cdiv(most, block))),)


def over_samples(kernel: Any, samples: GpuSamples, *arguments: object, **constants: object) -> None:
    """Launch a kernel over packed samples, whose number only the device knows."""
    grid = persistent_grid(samples.x.device, samples.capacity, SAMPLES)
    kernel[grid](*arguments, BLOCK=SAMPLES, num_stages=STAGES, **constants)


def over(kernel: Any, count: int, block: int, *arguments: object, **constants: object) -> None:
    """Launch a kernel on `count` items, if there are any, with `block` per program."""
    if count:
        kernel[(triton.cdiv(count, block),)](*arguments, BLOCK=block, **constants)


# -- marching ---------------------------------------------------------------------------------------------------------


def march_density(inputs: GpuMarchInputs, density, rays: GpuRays, capacity: int | None) -> GpuSamples:
    """March rays through a GpuDensity.

    capacity: maximum number of samples. If None, their number is read back, which synchronizes.
    """
    n, device = len(rays.origins), rays.origins.device
    counts = torch.empty(n, dtype=torch.int32, device=device)
    starts, ends = (torch.empty(n, dtype=torch.int64, device=device) for _ in range(2))
    largest, total = torch.empty(n, device=device), torch.zeros(1, dtype=torch.int64, device=device)
    # The counting pass needs no outputs, but Triton needs arguments: any tensors of the right type.
    nothing = GpuSamples(
        starts, ends, counts, largest, total, t=largest, deltas=largest, x=largest, sigma=largest, weights=largest,
        ray_of=counts,
    )  # fmt: skip
    _march_rays(inputs, density, rays, nothing, starts, 0, False)
    last = torch.cumsum(counts, 0, dtype=torch.int64)
    if capacity is None:
        capacity = int(last[-1]) if n else 0  # waits for the device
    t, deltas, sigma, weights = (torch.empty(capacity, device=device) for _ in range(4))
    points, ray_of = torch.empty((capacity, 3), device=device), torch.empty(capacity, dtype=torch.int32, device=device)
    samples = GpuSamples(starts, ends, counts, largest, total, t, deltas, points, sigma, weights, ray_of)
    _march_rays(inputs, density, rays, samples, last, capacity, True)
    return samples


def _march_rays(
    inputs: GpuMarchInputs, density, rays: GpuRays, samples: GpuSamples, last: Tensor, capacity: int, fill: bool
) -> None:
    n, s = len(rays.origins), samples
    # Without a displacement it is not read, but the kernel needs a pointer.
    moved = rays.origins if inputs.displacement is None else inputs.displacement
    over(
        march.march_kernel, n, RAYS, inputs.space, rays.origins, rays.directions, rays.jitter,
        float(inputs.near), float(inputs.far), float(inputs.step), inputs.distances, inputs.cells,
        inputs.samples_per_ray, float(inputs.min_transmittance),
        density.table, density.shift, *density.size, density.layout, moved, inputs.vertices,
        s.counts, last, capacity, s.starts, s.ends, s.largest, s.total,
        s.t, s.deltas, s.x, s.sigma, s.weights, s.ray_of, n,
        KIND=inputs.code, OPAQUE_BACKGROUND=inputs.opaque_background, DISPLACED=inputs.displacement is not None,
        FILL=fill, DENSITY=density.code, RANK=density.rank, WIDTH=density.width, num_warps=1,
    )  # fmt: skip


# -- hash grids and regions --------------------------------------------------------------------------------------------


def rows(table: Tensor, layout: Tensor, levels: int, points: Tensor) -> Tensor:
    """Return [n, 4 levels]: a hash grid's levels, concatenated, at points [n, 3] in 0..1."""
    n = len(points)
    out, constants = torch.empty((n, 4 * levels), device=points.device), {"LEVELS": levels, "num_stages": STAGES}
    over(hash_color.rows_kernel, n, SAMPLES, table, layout, points, out, n, **constants)
    return out


def rows_backward(layout: Tensor, levels: int, points: Tensor, gradients: Tensor, to: Tensor) -> None:
    """Add dL/d(table), from dL/d(rows) [n, 4 levels], to `to`."""
    n, constants = len(points), {"LEVELS": levels, "num_stages": STAGES}
    over(hash_color.rows_backward_kernel, n, SAMPLES, layout, points, gradients, to, n, **constants)


def zero_outside(marked: Tensor, cells: int, samples: GpuSamples, values: Tensor) -> None:
    """Set values [capacity] to 0 for samples outside the marked cells (uint8 [cells^3])."""
    over_samples(regions.keep_kernel, samples, marked, cells, samples.x, samples.total, values)


def mark_cells(samples: GpuSamples, cells: int, min_weight: float, marked: Tensor) -> None:
    """Set `marked` (uint8 [cells^3]) to 1 where a sample's weight is at least `min_weight`; not for the background."""
    s = samples
    over_samples(regions.mark_kernel, s, s.x, s.weights, s.deltas, s.total, float(min_weight), cells, marked)


def ends_inside(marked: Tensor, cells: int, samples: GpuSamples) -> Tensor:
    """Return [rays, 6]: sum w, then sums over marked cells of w, w t and w x."""
    n, s = len(samples.starts), samples
    out = torch.empty((n, 6), device=s.x.device)
    over(regions.ends_kernel, n, POINTS, marked, cells, s.x, s.t, s.weights, s.starts, s.ends, out, n)
    return out


# -- pixels, losses, optimization -------------------------------------------------------------------------------------


def composite(samples: GpuSamples, colors: Tensor) -> Tensor:
    """Return [rays, 5]: sum w c (3), sum w, sum w t without the opaque background."""
    n, s = len(samples.starts), samples
    out = torch.empty((n, 5), device=colors.device)
    arguments = s.weights, s.deltas, colors, s.t, s.starts, s.ends, out, n
    over(compositing.composite_kernel, n, RAYS, *arguments, num_warps=1)
    return out


def surface_distance(samples: GpuSamples) -> Tensor:
    """Return the distance of the visible surface [rays], scene units, 0 where there is none."""
    n, s = len(samples.starts), samples
    out = torch.empty(n, device=s.t.device)
    over(compositing.surface_distance_kernel, n, RAYS, s.weights, s.t, s.starts, s.ends, out, n, num_warps=1)
    return out


def composite_backward(
    samples: GpuSamples, colors: Tensor, out: Tensor, gradients: Tensor, near_scaling_distance: float
) -> tuple[Tensor, Tensor]:
    """Return dL/d(sigma) [capacity], dL/d(color) [capacity, 3] from dL/d(out) [rays, 5]; undefined after the last."""
    n, s = len(out), samples
    sigma_gradients, color_gradients = torch.empty_like(s.sigma), torch.empty_like(colors)
    arguments = s.weights, s.deltas, colors, s.t, s.starts, s.ends, out, gradients, float(near_scaling_distance)
    over(
        compositing.composite_backward_kernel, n, RAYS, *arguments, sigma_gradients, color_gradients, n, num_warps=1
    )  # fmt: skip
    return sigma_gradients, color_gradients


def distortion_backward(samples: GpuSamples, strength: float, middle: float, sigma_gradients: Tensor) -> None:
    """Add dL/d(sigma) of the rays' distortion loss, times `strength`, to sigma_gradients [capacity]."""
    s, n = samples, len(samples.starts)
    arguments = s.weights, s.deltas, s.t, s.starts, s.ends, float(strength), float(middle)
    over(compositing.distortion_backward_kernel, n, RAYS, *arguments, sigma_gradients, n, num_warps=1)


def photometric_loss(out: Tensor, wanted, background, samples: GpuSamples, scale: float, sums: Tensor) -> Tensor:
    """Return dL/d(out) of the squared error; add (squared error, samples, rays that do not fit) to sums [3]."""
    gradients, n, s = torch.empty_like(out), len(out), samples
    arguments = out, wanted, background, s.counts, s.starts, s.ends, float(scale)
    over(compositing.loss_kernel, n, POINTS, *arguments, gradients, sums, n)
    return gradients


def shade_backward(samples: GpuSamples, gradients: Tensor) -> Tensor:
    """Return dL/d(color) [n, 3] from dL/d(sum w c) [rays, 3], for samples that fill their capacity."""
    out, n = torch.empty_like(samples.x), len(samples.weights)
    over(compositing.shade_backward_kernel, n, POINTS, samples.weights, gradients, samples.ray_of, out, n)
    return out


def tuning_loss(
    out: Tensor, wanted: Tensor, depth: Tensor, samples: GpuSamples, level: float, scale: float, depth_scale: float,
    sums: Tensor,
) -> Tensor:  # fmt: skip
    """Return dL/d(out) [rays, 5] and add to sums [5]; see tuning_loss_kernel. depth [m]: of the first m rays."""
    gradients, n, s = torch.empty_like(out), len(out), samples
    over(
        compositing.tuning_loss_kernel, n, POINTS, out, wanted, depth if len(depth) else out, s.counts, s.starts,
        s.ends, float(level), float(scale), float(depth_scale), len(depth), gradients, sums, n,
    )  # fmt: skip
    return gradients


def adam(state: GpuAdamState, rates: AdamRates, begin: int, end: int) -> None:
    """Take one step of Adam on values[begin:end]."""
    s = state
    over(
        optimizer.adam_kernel, triton.cdiv(end - begin, 8), RUNS, s.values, s.gradients, s.first, s.second, *rates,
        begin, end,
    )  # fmt: skip


def _golden(draws: int) -> int:
    """Return the advance of the low-discrepancy sequence after `draws` draws, modulo 2^32, as a signed integer."""
    return (draws * int(pixel_rays.GOLDEN.value) + 2**31) % 2**32 - 2**31


def draw_rays(photos: GpuPhotos, draw: RayDraw, count: int) -> tuple[GpuRays, Tensor, Tensor]:
    """Return `count` random rays, their straight rgba [n, 4] and background [n, 3]; see pixel_rays.draw_kernel."""
    p, device, views = photos, photos.bytes.device, len(photos.widths)
    origins, directions, background = (torch.empty((count, 3), device=device) for _ in range(3))
    wanted, jitter = torch.empty((count, 4), device=device), torch.empty(count, device=device)
    over(
        pixel_rays.draw_kernel, count, POINTS, draw.seed, draw.sequence, _golden(draw.earlier),
        _golden(draw.lit_earlier), draw.first, count, draw.total, p.lit, draw.lit_total, draw.lit_rays, p.view_ends,
        p.view_sizes, views, p.widths, p.intrinsics, p.poses, p.bytes, p.codes,
        float(draw.level or 0), origins, directions, wanted, jitter, background,
        CHANNELS=p.channels, RANDOM_BACKGROUND=draw.level is None, STEPS=max(1, (views - 1).bit_length()),
    )  # fmt: skip
    return GpuRays(origins, directions, jitter), wanted, background


def rays_of_pixels(photos: GpuPhotos, chosen: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return (origins, directions [n, 3], straight rgba [n, 4]) of pixels [n] int64, numbered across all views."""
    n, p, views = len(chosen), photos, len(photos.widths)
    origins, directions = (torch.empty((n, 3), device=chosen.device) for _ in range(2))
    wanted = torch.empty((n, 4), device=chosen.device)
    over(
        pixel_rays.rays_kernel, n, POINTS, chosen, n, p.view_ends, p.view_sizes, views, p.widths,
        p.intrinsics, p.poses, p.bytes, p.codes, origins, directions, wanted,
        CHANNELS=p.channels, STEPS=max(1, (views - 1).bit_length()),
    )  # fmt: skip
    return origins, directions, wanted


# -- deformations -----------------------------------------------------------------------------------------------------


def displacement_backward(
    code: int, space: Tensor, rays: GpuRays, samples: GpuSamples, position_gradients: Tensor, vertices: int, to: Tensor
) -> None:
    """Add dL/dD to `to`, flat [vertices^3, 3], from dL/dx' [capacity, 3]; code, space: as in GpuMarchInputs."""
    s = samples
    over_samples(
        deformation.displacement_backward_kernel, s, space, rays.origins, rays.directions, s.ray_of, s.t, s.deltas,
        s.x, position_gradients, s.total, to, vertices, KIND=code,
    )  # fmt: skip


def displaced_cells(distances: Tensor, cells: int, reach: int, displacement: Tensor, vertices: int) -> Tensor:
    """Return [cells, cells, cells] bool: cells with an x whose x + D(x) is in a cell at distance 0.

    displacement: D, flat [vertices^3 * 3]. reach: upper bound of D in cells, plus one.
    """
    occupied = torch.empty(cells**3, dtype=torch.uint8, device=distances.device)
    arguments = distances, cells, reach, displacement, vertices, occupied
    over(deformation.displaced_cells_kernel, cells**3, CELLS, *arguments)
    return occupied.view(cells, cells, cells) > 0
