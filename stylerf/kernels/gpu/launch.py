"""Kernel launches: grids, blocks, constants. Nothing here waits for the device, unless it says so.

Parts of fields (fields/gpu/parts.py) hand over what their kernels read: `table`, `layout`, `size`, `code`, `rank` and
`width` describe a table as tables.py reads it, `pieces`, `numbers`, `head`, `hidden` and `bands` a color head.
"""

import torch
import triton
from torch import Tensor

from stylerf.kernels.gpu import adam as optimizer
from stylerf.kernels.gpu import (
    color_heads,
    compositing,
    deformation,
    hash_color,
    hash_levels,
    interpreted,
    march,
    pixel_rays,
    regions,
    tables,
    vm,
    voxel,
)
from stylerf.kernels.gpu.ray_samples import GpuMarchInputs, GpuRays, GpuSamples

# Rays or samples per program. Marches diverge, so that few rays share a program; the interpreter pays per program.
RAYS, SAMPLES, POINTS, RUNS = (256, 512, 1024, 4096) if interpreted() else (32, 64, 128, 128)
CELLS = 1024 if interpreted() else 32  # per program, each of 32 lanes
# No software pipeline: it would copy the gathered rows through 170 KB of shared memory, more than most GPUs have.
STAGES = 1
PROGRAMS_PER_PROCESSOR = 8  # of kernels that walk a list whose length only the device knows
# With four, the network's backward on hash features keeps 4.6 KB a thread in local memory, with eight 0.2 KB (compiled
# for capability 9.0).
HEAD_WARPS = 8
HEADS = {
    "linear": (color_heads.LINEAR.value, color_heads.linear_backward_kernel),
    "harmonic": (color_heads.HARMONIC.value, color_heads.harmonic_backward_kernel),
    "mlp": (color_heads.MLP.value, color_heads.mlp_backward_kernel),
}


def width_of(rank: int) -> int:
    """Return the columns of a tile of rows; tl.dot needs at least sixteen."""
    return max(16, triton.next_power_of_2(rank))


def outputs_of(bands: int) -> int:
    """Return the columns of a tile of the color head's outputs."""
    return max(16, triton.next_power_of_2(3 * bands))


def persistent_grid(device: torch.device, most: int, block: int) -> tuple[int]:
    """Return enough programs to occupy the device, for lists of at most `most` entries."""
    if device.type != "cuda":
        return (min(2, max(1, triton.cdiv(most, block))),)
    processors = torch.cuda.get_device_properties(device).multi_processor_count
    return (max(1, min(processors * PROGRAMS_PER_PROCESSOR, triton.cdiv(most, block))),)


# -- marching and densities -------------------------------------------------------------------------------------------


def march_density(inputs: GpuMarchInputs, density, rays: GpuRays, room: int | None) -> GpuSamples:
    """March rays through a density.

    room: most samples there is memory for. With None the number is read back, which waits for the device.
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
    if room is None:
        room = int(last[-1]) if n else 0
    t, deltas, sigma, weights = (torch.empty(room, device=device) for _ in range(4))
    points, ray_of = torch.empty((room, 3), device=device), torch.empty(room, dtype=torch.int32, device=device)
    samples = GpuSamples(starts, ends, counts, largest, total, t, deltas, points, sigma, weights, ray_of)
    _march_rays(inputs, density, rays, samples, last, room, True)
    return samples


def _march_rays(
    inputs: GpuMarchInputs, density, rays: GpuRays, samples: GpuSamples, last: Tensor, room: int, fill: bool
) -> None:
    n, s = len(rays.origins), samples
    if not n:
        return
    moved = rays.origins if inputs.displacement is None else inputs.displacement
    march.march_kernel[(triton.cdiv(n, RAYS),)](
        inputs.space, rays.origins, rays.directions, rays.jitter, float(inputs.near), float(inputs.far),
        float(inputs.step), inputs.distances, inputs.cells, inputs.samples_per_ray, float(inputs.min_transmittance),
        density.table, density.shift, *density.size, density.layout, moved, inputs.vertices,
        s.counts, last, room, s.starts, s.ends, s.largest, s.total,
        s.t, s.deltas, s.x, s.sigma, s.weights, s.ray_of, n,
        KIND=inputs.code, OPAQUE_BACKGROUND=inputs.opaque_background, DISPLACED=inputs.displacement is not None,
        FILL=fill, DENSITY=density.code, RANK=density.rank, WIDTH=density.width, BLOCK=RAYS, num_warps=1,
    )  # fmt: skip


def density_at(density, points: Tensor) -> Tensor:
    """Return raw density [n] at points [n, 3] in the unit cube."""
    out = torch.empty(len(points), device=points.device)
    if len(points):
        tables.density_kernel[(triton.cdiv(len(points), POINTS),)](
            density.table, density.layout, density.shift, points, out, len(points), *density.size,
            DENSITY=density.code, RANK=density.rank, WIDTH=density.width, BLOCK=POINTS,
        )  # fmt: skip
    return out


def density_backward(density, samples: GpuSamples, sigma_gradients: Tensor, to: Tensor) -> None:
    """Add dL/d(values) to `to` [len(values)]: table, shift."""
    tables.density_backward_kernel[persistent_grid(to.device, samples.room, SAMPLES)](
        density.table, density.layout, samples.x, samples.sigma, sigma_gradients, samples.total, to, to[-1:],
        *density.size, DENSITY=density.code, RANK=density.rank, WIDTH=density.width, BLOCK=SAMPLES, num_stages=STAGES,
    )  # fmt: skip


# -- smoothness: gradients of strength/2 times the summed squared differences of neighbors, added to `to` -------------


def plane_smoothness(table: Tensor, size: list[int], rank: int, strength: float, to: Tensor) -> None:
    """Of the texels of vm planes."""
    begin = 0
    for a, b in ((1, 2), (2, 0), (0, 1)):
        rows, columns = size[a], size[b]
        vm.smoothness_kernel[(triton.cdiv(rows * columns, SAMPLES),)](
            table, to, float(strength), rows, columns, begin, RANK=rank, WIDTH=width_of(rank), BLOCK=SAMPLES
        )
        begin += rows * columns


def level_smoothness(table: Tensor, strength: float, vertices: int, first: int, row: int, to: Tensor) -> None:
    """Of one direct level of a hash grid: its vertices a side, its first float, floats at a vertex."""
    hash_levels.smoothness_kernel[(triton.cdiv(vertices**3 * row, POINTS),)](
        table, to, float(strength), vertices, first, ROW=row, BLOCK=POINTS
    )


def voxel_smoothness(table: Tensor, links: Tensor, places: Tensor, size, row: int, strength: float, to: Tensor) -> None:
    """Of allocated voxels. places: int32 [blocks of the table, 3]; row: floats at a vertex."""
    rows = 64 * len(places)
    voxel.smoothness_kernel[(triton.cdiv(rows, SAMPLES),)](
        table, links, places, to, float(strength), rows, *size,
        ROW=row, WIDTH=triton.next_power_of_2(row), BLOCK=SAMPLES,
    )  # fmt: skip


# -- colors -----------------------------------------------------------------------------------------------------------


def _head_constants(color) -> dict:
    plain = color.code == tables.VM.value and color.head == "linear"  # few registers: Triton's own number of warps
    return {
        "ENCODER": color.code, "PIECES": color.pieces, "RANK": color.rank, "WIDTH": width_of(color.rank),
        "BANDS": color.bands, "UNITS": color.hidden or outputs_of(color.bands), "BLOCK": SAMPLES,
        "num_warps": 4 if plain else HEAD_WARPS, "num_stages": STAGES,
    }  # fmt: skip


def headed_colors(color, samples: GpuSamples, directions: Tensor | None, weight_threshold: float) -> Tensor:
    """Return [room, 3] colors; -1 in channel 0 below weight_threshold times the ray's largest weight."""
    out = torch.empty((samples.room, 3), device=samples.x.device)
    color_heads.color_kernel[persistent_grid(out.device, samples.room, SAMPLES)](
        color.table, color.layout, color.numbers, samples.x, directions, samples.ray_of, samples.weights,
        samples.largest, float(weight_threshold), samples.total, out, *color.size, HEAD=HEADS[color.head][0],
        **_head_constants(color),
    )  # fmt: skip
    return out


def headed_colors_backward(color, samples: GpuSamples, directions, colors, color_gradients, to: Tensor) -> None:
    """Add dL/d(values) to `to` [len(values)]: the features' table, the head's numbers."""
    HEADS[color.head][1][persistent_grid(to.device, samples.room, SAMPLES)](
        color.table, color.layout, color.numbers, samples.x, directions, samples.ray_of, colors, color_gradients,
        samples.total, to, to[len(color.table) :], *color.size, **_head_constants(color),
    )  # fmt: skip


def hash_colors(color, samples: GpuSamples, weight_threshold: float) -> Tensor:
    """As headed_colors, of a hash grid whose levels are summed."""
    out = torch.empty((samples.room, 3), device=samples.x.device)
    hash_color.color_kernel[persistent_grid(out.device, samples.room, SAMPLES)](
        color.table, color.layout, samples.x, samples.ray_of, samples.weights, samples.largest, float(weight_threshold),
        samples.total, out, LEVELS=color.levels, BLOCK=SAMPLES, num_stages=STAGES,
    )  # fmt: skip
    return out


def hash_colors_backward(color, samples: GpuSamples, colors, color_gradients, to: Tensor) -> None:
    hash_color.color_backward_kernel[persistent_grid(to.device, samples.room, SAMPLES)](
        color.layout, samples.x, colors, color_gradients, samples.total, to, LEVELS=color.levels, BLOCK=SAMPLES,
        num_stages=STAGES,
    )  # fmt: skip


def rows(table: Tensor, layout: Tensor, levels: int, points: Tensor) -> Tensor:
    """[n, 4 levels]: a hash grid's levels side by side at points [n, 3] in 0..1."""
    n = len(points)
    out = torch.empty((n, 4 * levels), device=points.device)
    if n:
        hash_color.rows_kernel[(triton.cdiv(n, SAMPLES),)](
            table, layout, points, out, n, LEVELS=levels, BLOCK=SAMPLES, num_stages=STAGES
        )
    return out


def rows_backward(layout: Tensor, levels: int, points: Tensor, gradients: Tensor, to: Tensor) -> None:
    """Add dL/d(table), from dL/d(rows) [n, 4 levels], to `to`."""
    n = len(points)
    if n:
        hash_color.rows_backward_kernel[(triton.cdiv(n, SAMPLES),)](
            layout, points, gradients, to, n, LEVELS=levels, BLOCK=SAMPLES, num_stages=STAGES
        )


# -- regions ----------------------------------------------------------------------------------------------------------


def region_colors(part, samples: GpuSamples, colors: Tensor) -> None:
    """Add the region's logits to the base's colors [room, 3], in place. part: a GpuRegionColor."""
    regions.color_kernel[persistent_grid(colors.device, samples.room, SAMPLES)](
        part.table, part.layout, part.marked, part.cells, part.box, samples.x, samples.total, colors,
        LEVELS=part.levels, BLOCK=SAMPLES, num_stages=STAGES,
    )  # fmt: skip


def region_colors_backward(part, samples: GpuSamples, colors: Tensor, color_gradients, to: Tensor) -> None:
    """Add dL/d(values) to `to` [len(values)]."""
    regions.color_backward_kernel[persistent_grid(to.device, samples.room, SAMPLES)](
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


# -- pixels, losses, optimization -------------------------------------------------------------------------------------


def composite(samples: GpuSamples, colors: Tensor) -> Tensor:
    """Return [rays, 5]: sum w c (3), sum w, sum w t without the opaque background."""
    n = len(samples.starts)
    out = torch.empty((n, 5), device=colors.device)
    if n:
        compositing.composite_kernel[(triton.cdiv(n, RAYS),)](
            samples.weights, samples.deltas, colors, samples.t, samples.starts, samples.ends, out, n, BLOCK=RAYS,
            num_warps=1,
        )  # fmt: skip
    return out


def surface_distance(samples: GpuSamples) -> Tensor:
    """Return [rays]: distance of the visible surface, scene units, 0 where there is none."""
    n = len(samples.starts)
    out = torch.empty(n, device=samples.t.device)
    if n:
        compositing.surface_distance_kernel[(triton.cdiv(n, RAYS),)](
            samples.weights, samples.t, samples.starts, samples.ends, out, n, BLOCK=RAYS, num_warps=1
        )
    return out


def composite_backward(
    samples: GpuSamples, colors: Tensor, out: Tensor, gradients: Tensor, near_scaling_distance: float
) -> tuple[Tensor, Tensor]:
    """Return dL/d(sigma) [room], dL/d(color) [room, 3] from dL/d(out) [rays, 5]; undefined beyond the last sample."""
    sigma_gradients, color_gradients = torch.empty_like(samples.sigma), torch.empty_like(colors)
    if len(out):
        compositing.composite_backward_kernel[(triton.cdiv(len(out), RAYS),)](
            samples.weights, samples.deltas, colors, samples.t, samples.starts, samples.ends, out, gradients,
            float(near_scaling_distance), sigma_gradients, color_gradients, len(out), BLOCK=RAYS, num_warps=1,
        )  # fmt: skip
    return sigma_gradients, color_gradients


def photometric_loss(out: Tensor, wanted, background, samples: GpuSamples, scale: float, sums: Tensor) -> Tensor:
    """Return dL/d(out) of the squared error; add (squared error, samples, rays without room) to sums [3]."""
    gradients = torch.empty_like(out)
    compositing.loss_kernel[(triton.cdiv(len(out), POINTS),)](
        out, wanted, background, samples.counts, samples.starts, samples.ends, float(scale), gradients, sums, len(out),
        BLOCK=POINTS,
    )  # fmt: skip
    return gradients


def shade_backward(samples: GpuSamples, gradients: Tensor) -> Tensor:
    """Return dL/d(color) [n, 3] from dL/d(sum w c) [rays, 3], for samples that fill their room."""
    out, n = torch.empty_like(samples.x), len(samples.weights)
    if n:
        compositing.shade_backward_kernel[(triton.cdiv(n, POINTS),)](
            samples.weights, gradients, samples.ray_of, out, n, BLOCK=POINTS
        )
    return out


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


def adam(values, gradients, first, second, rate, betas, epsilon, corrections, begin: int, end: int) -> None:
    """Take one step of Adam on values[begin:end]."""
    optimizer.adam_kernel[(triton.cdiv(triton.cdiv(end - begin, 8), RUNS),)](
        values, gradients, first, second, float(rate), *betas, epsilon, *corrections, begin, end, BLOCK=RUNS
    )


def draw_rays(
    bank, seed, first, total, lit_total, lit_rays, level, origins, directions, wanted, jitter, background
) -> None:
    """Draw random rays of a RayDatasetGpu; see pixel_rays.draw_kernel. level None: random background."""
    n = len(origins)
    pixel_rays.draw_kernel[(triton.cdiv(n, POINTS),)](
        seed, first, n, total, bank.lit, lit_total, lit_rays, bank.view_ends, bank.view_sizes, bank.views, bank.widths,
        bank.intrinsics, bank.poses, bank.bytes, bank.codes, float(level or 0), origins, directions, wanted, jitter,
        background,
        CHANNELS=bank.channels, RANDOM_BACKGROUND=level is None, STEPS=max(1, (bank.views - 1).bit_length()),
        BLOCK=POINTS,
    )  # fmt: skip


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


# -- deformations -----------------------------------------------------------------------------------------------------


def add_density_slopes(density, samples: GpuSamples, sigma_gradients: Tensor, out: Tensor) -> None:
    """Add dL/dx of a vm density to out [room, 3]."""
    deformation.density_position_kernel[persistent_grid(out.device, samples.room, SAMPLES)](
        density.table, samples.x, samples.sigma, sigma_gradients, samples.total, out, *density.size,
        RANK=density.rank, WIDTH=width_of(density.rank), BLOCK=SAMPLES, num_stages=STAGES,
    )  # fmt: skip


def add_vm_color_slopes(color, samples: GpuSamples, directions, colors, color_gradients, out: Tensor) -> None:
    """Add dL/dx of vm colors to out [room, 3]."""
    deformation.vm_color_position_kernel[persistent_grid(out.device, samples.room, SAMPLES)](
        color.table, color.numbers, samples.x, directions, samples.ray_of, colors, color_gradients, samples.total, out,
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
    code: int, space: Tensor, rays: GpuRays, samples: GpuSamples, position_gradients: Tensor, vertices: int, to: Tensor
) -> None:
    """Add dL/dD to `to`, flat [vertices^3, 3], from dL/dx' [room, 3]; code, space: as in GpuMarchInputs."""
    deformation.displacement_backward_kernel[persistent_grid(to.device, samples.room, SAMPLES)](
        space, rays.origins, rays.directions, samples.ray_of, samples.t, samples.deltas, samples.x, position_gradients,
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
