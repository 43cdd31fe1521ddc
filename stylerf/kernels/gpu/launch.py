"""How the kernels are launched: grids, blocks, constants. Nothing here waits for the device."""

from dataclasses import dataclass

import torch
import triton
from torch import Tensor

from stylerf.kernels.gpu import adam as optimizer
from stylerf.kernels.gpu import compositing as composite_kernels
from stylerf.kernels.gpu import hash_color as hash_kernels
from stylerf.kernels.gpu import interpreted, march, pixel_rays, vm

# Rays or samples per program. Marches diverge, so that few rays share a program; the interpreter pays per program.
RAYS, SAMPLES, POINTS, RUNS = (256, 512, 1024, 4096) if interpreted() else (32, 64, 128, 128)
# No software pipeline: it would copy the gathered rows through 170 KB of shared memory, more than most GPUs have.
STAGES = 1
PROGRAMS_PER_PROCESSOR = 8  # of kernels that inputs a list whose length only the device knows


@dataclass
class GpuSamples:
    """Samples along rays, packed without padding; as Samples in kernels/cpu/ray_samples.py, and beyond that:

    Attributes:
        counts: [rays], samples that each ray wanted; its starts:ends is empty if they found no room.
        largest: [rays], each ray's largest weight.
        total: [1] int64, number of samples.
        ray_of: [room], each sample's ray.
    """

    starts: Tensor
    ends: Tensor
    counts: Tensor
    largest: Tensor
    total: Tensor
    t: Tensor
    deltas: Tensor
    x: Tensor
    sigma: Tensor
    weights: Tensor
    ray_of: Tensor

    @property
    def room(self) -> int:
        """Samples there is memory for."""
        return len(self.t)


def width_of(rank: int) -> int:
    """Columns of a tile of rows: products of tiles need at least sixteen."""
    return max(16, triton.next_power_of_2(rank))


def outputs_of(bands: int) -> int:
    """Columns of a tile of the color head's outputs."""
    return max(16, triton.next_power_of_2(3 * bands))


def persistent_grid(device: torch.device, most: int, block: int) -> tuple[int]:
    """As many programs as keep the device busy, for lists of at most `most` entries."""
    if device.type != "cuda":
        return (min(2, max(1, triton.cdiv(most, block))),)
    processors = torch.cuda.get_device_properties(device).multi_processor_count
    return (max(1, min(processors * PROGRAMS_PER_PROCESSOR, triton.cdiv(most, block))),)


@dataclass(frozen=True)
class GpuMarchInputs:
    """What a march reads beside rays and density; space: numbers [7] on the device; step: cube units."""

    code: int
    space: Tensor
    near: float
    far: float
    step: float
    distances: Tensor  # [cells^3] uint8
    cells: int
    opaque_background: bool
    displacement: Tensor | None  # flat [m^3 * 3]
    vertices: int
    samples_per_ray: int
    min_transmittance: float


def march_density(
    inputs: GpuMarchInputs, density, origins: Tensor, directions: Tensor, jitter: Tensor, room: int | None
) -> GpuSamples:
    """March rays through a density.

    Args:
        density: has table, shift, layout, size, code, rank and width; see density.raw_density.
        room: most samples there is memory for. With None the number is read back, which waits for the device.
    """
    n, device = len(origins), origins.device
    counts, int64 = torch.empty(n, dtype=torch.int32, device=device), {"dtype": torch.int64, "device": device}
    starts, ends = torch.empty(n, **int64), torch.empty(n, **int64)
    largest, total = torch.empty(n, device=device), torch.zeros(1, **int64)
    # The counting pass needs no outputs, but Triton needs arguments: any tensors of the right type.
    nothing = GpuSamples(starts, ends, counts, largest, total, *[largest] * 5, counts)
    _march_rays(inputs, density, origins, directions, jitter, nothing, starts, 0, False)
    last = torch.cumsum(counts, 0, dtype=torch.int64)
    if room is None:
        room = int(last[-1]) if n else 0
    one = [torch.empty(room, device=device) for _ in range(4)]
    points = torch.empty((room, 3), device=device)
    ray_of = torch.empty(room, dtype=torch.int32, device=device)
    samples = GpuSamples(starts, ends, counts, largest, total, one[0], one[1], points, one[2], one[3], ray_of)
    _march_rays(inputs, density, origins, directions, jitter, samples, last, room, True)
    return samples


def _march_rays(inputs, density, origins, directions, jitter, samples: GpuSamples, last, room, fill: bool) -> None:
    n = len(origins)
    if not n:
        return
    s, moved = samples, origins if inputs.displacement is None else inputs.displacement
    layout = s.counts if density.layout is None else density.layout
    march.march_kernel[(triton.cdiv(n, RAYS),)](
        inputs.space, origins, directions, jitter, float(inputs.near), float(inputs.far), float(inputs.step),
        inputs.distances, inputs.cells, inputs.samples_per_ray, float(inputs.min_transmittance),
        density.table, density.shift, *density.size, layout, moved, inputs.vertices,
        s.counts, last, room, s.starts, s.ends, s.largest, s.total,
        s.t, s.deltas, s.x, s.sigma, s.weights, s.ray_of, n,
        KIND=inputs.code, OPAQUE_BACKGROUND=inputs.opaque_background, DISPLACED=inputs.displacement is not None,
        FILL=fill, DENSITY=density.code, RANK=density.rank, WIDTH=density.width, BLOCK=RAYS, num_warps=1,
    )  # fmt: skip


def vm_density(density, points: Tensor) -> Tensor:
    """Raw density [n] of cube points [n, 3]."""
    out = torch.empty(len(points), device=points.device)
    if len(points):
        vm.density_kernel[(triton.cdiv(len(points), POINTS),)](
            density.table, density.shift, points, out, len(points), *density.size,
            RANK=density.rank, WIDTH=width_of(density.rank), BLOCK=POINTS,
        )  # fmt: skip
    return out


def vm_density_backward(density, samples: GpuSamples, sigma_gradients: Tensor, to: Tensor) -> None:
    """Add dL/d(values) to `to` [len(values)]: table, shift."""
    vm.density_backward_kernel[persistent_grid(to.device, samples.room, SAMPLES)](
        density.table, samples.x, samples.sigma, sigma_gradients, samples.total, to, to[-1:], *density.size,
        RANK=density.rank, WIDTH=width_of(density.rank), BLOCK=SAMPLES, num_stages=STAGES,
    )  # fmt: skip


def vm_colors(color, samples: GpuSamples, directions: Tensor, weight_threshold: float) -> Tensor:
    """Return [room, 3] colors; -1 in channel 0 below weight_threshold times the ray's largest weight."""
    out = torch.empty((samples.room, 3), device=directions.device)
    vm.color_kernel[persistent_grid(out.device, samples.room, SAMPLES)](
        color.table, color.head, color.bias, samples.x, directions, samples.ray_of, samples.weights,
        samples.largest, float(weight_threshold), samples.total, out, *color.size,
        RANK=color.rank, WIDTH=width_of(color.rank), BANDS=color.bands, OUTPUTS=outputs_of(color.bands),
        BLOCK=SAMPLES, num_stages=STAGES,
    )  # fmt: skip
    return out


def vm_colors_backward(color, samples: GpuSamples, directions, colors, color_gradients, to: Tensor) -> None:
    """Add dL/d(values) to `to` [len(values)]: table, head, bias."""
    table = len(color.table)
    vm.color_backward_kernel[persistent_grid(to.device, samples.room, SAMPLES)](
        color.table, color.head, samples.x, directions, samples.ray_of, colors, color_gradients, samples.total,
        to, to[table:-3], to[-3:], *color.size,
        RANK=color.rank, WIDTH=width_of(color.rank), BANDS=color.bands, OUTPUTS=outputs_of(color.bands),
        BLOCK=SAMPLES, num_stages=STAGES,
    )  # fmt: skip


def hash_colors(color, samples: GpuSamples, weight_threshold: float) -> Tensor:
    """As vm_colors, of a hash grid."""
    out = torch.empty((samples.room, 3), device=samples.x.device)
    hash_kernels.color_kernel[persistent_grid(out.device, samples.room, SAMPLES)](
        color.table, color.layout, samples.x, samples.ray_of, samples.weights, samples.largest, float(weight_threshold),
        samples.total, out, LEVELS=color.levels, BLOCK=SAMPLES, num_stages=STAGES,
    )  # fmt: skip
    return out


def hash_colors_backward(color, samples: GpuSamples, colors, color_gradients, to: Tensor) -> None:
    """Add dL/d(values) to `to`."""
    hash_kernels.color_backward_kernel[persistent_grid(to.device, samples.room, SAMPLES)](
        color.layout, samples.x, colors, color_gradients, samples.total, to, LEVELS=color.levels, BLOCK=SAMPLES,
        num_stages=STAGES,
    )  # fmt: skip


def smoothness(part, strength: float, to: Tensor) -> None:
    """Add the gradient of strength/2 times the summed squared differences of plane texels to `to`."""
    size, begin = part.size, 0
    for a, b in ((1, 2), (2, 0), (0, 1)):
        rows, columns = size[a], size[b]
        vm.smoothness_kernel[(triton.cdiv(rows * columns, SAMPLES),)](
            part.values, to, float(strength), rows, columns, begin,
            RANK=part.rank, WIDTH=width_of(part.rank), BLOCK=SAMPLES,
        )  # fmt: skip
        begin += rows * columns


def composite(samples: GpuSamples, colors: Tensor) -> Tensor:
    """[rays, 5]: sum w c (3), sum w, sum w t without a backdrop's."""
    n = len(samples.starts)
    out = torch.empty((n, 5), device=colors.device)
    if n:
        composite_kernels.composite_kernel[(triton.cdiv(n, RAYS),)](
            samples.weights, samples.deltas, colors, samples.t, samples.starts, samples.ends, out, n, BLOCK=RAYS,
            num_warps=1,
        )  # fmt: skip
    return out


def surface_distance(samples: GpuSamples) -> Tensor:
    """[rays]: distance of what each ray shows, scene units, 0 where there is nothing."""
    n = len(samples.starts)
    out = torch.empty(n, device=samples.t.device)
    if n:
        composite_kernels.surface_distance_kernel[(triton.cdiv(n, RAYS),)](
            samples.weights, samples.t, samples.starts, samples.ends, out, n, BLOCK=RAYS, num_warps=1
        )
    return out


def composite_backward(
    samples: GpuSamples, colors: Tensor, out: Tensor, gradients: Tensor, near_scaling_distance: float
) -> tuple[Tensor, Tensor]:
    """(dL/d(sigma) [room], dL/d(color) [room, 3]) from dL/d(out) [rays, 5]; unset beyond the samples there are."""
    sigma_gradients, color_gradients = torch.empty_like(samples.sigma), torch.empty_like(colors)
    if len(out):
        composite_kernels.composite_backward_kernel[(triton.cdiv(len(out), RAYS),)](
            samples.weights, samples.deltas, colors, samples.t, samples.starts, samples.ends, out, gradients,
            float(near_scaling_distance), sigma_gradients, color_gradients, len(out), BLOCK=RAYS, num_warps=1,
        )  # fmt: skip
    return sigma_gradients, color_gradients


def photometric_loss(out: Tensor, wanted, background, samples: GpuSamples, scale: float, sums: Tensor) -> Tensor:
    """dL/d(out) of the squared error; adds (squared error, samples, rays without room) to sums [3]."""
    gradients = torch.empty_like(out)
    composite_kernels.loss_kernel[(triton.cdiv(len(out), POINTS),)](
        out, wanted, background, samples.counts, samples.starts, samples.ends, float(scale), gradients, sums, len(out),
        BLOCK=POINTS,
    )  # fmt: skip
    return gradients


def adam(values, gradients, first, second, rate, betas, epsilon, corrections, begin: int, end: int) -> None:
    """One step of Adam on values[begin:end]."""
    optimizer.adam_kernel[(triton.cdiv(triton.cdiv(end - begin, 8), RUNS),)](
        values, gradients, first, second, float(rate), *betas, epsilon, *corrections, begin, end, BLOCK=RUNS
    )


def draw_rays(
    bank, seed, first, total, lit_total, lit_rays, level, origins, directions, wanted, jitter, background
) -> None:
    """Random rays of a DeviceBank; see pixels.draw_kernel. level None: random background."""
    n = len(origins)
    pixel_rays.draw_kernel[(triton.cdiv(n, POINTS),)](
        seed, first, n, total, bank.lit, lit_total, lit_rays, bank.view_ends, bank.view_sizes, bank.views, bank.widths,
        bank.intrinsics, bank.poses, bank.bytes, bank.codes, float(level or 0), origins, directions, wanted, jitter,
        background,
        CHANNELS=bank.channels, RANDOM_BACKGROUND=level is None, STEPS=max(1, (bank.views - 1).bit_length()),
        BLOCK=POINTS,
    )  # fmt: skip


def shade_backward(samples: GpuSamples, gradients: Tensor) -> Tensor:
    """dL/d(color) [n, 3] of samples that fill their room, from dL/d(sum w c) [rays, 3]."""
    out, n = torch.empty_like(samples.x), len(samples.weights)
    if n:
        composite_kernels.shade_backward_kernel[(triton.cdiv(n, POINTS),)](
            samples.weights, gradients, samples.ray_of, out, n, BLOCK=POINTS
        )
    return out
