"""Draw random rays and their colors from 8-bit photos on the device."""

import triton
import triton.language as tl

from stylerf.kernels.gpu.indexing import offset, store_vector

GOLDEN = tl.constexpr(0x9E3779B9)  # 2^32 over the golden ratio


@triton.jit
def _below(bits, bound):
    """An integer 0 <= n < bound (int64, under 2^31) from 32 random bits; biased by less than bound / 2^32."""
    return (bits.to(tl.uint32).to(tl.int64) * bound) >> 32


@triton.jit
def _evenly(start, shift, number):
    """32 bits of low-discrepancy draw `number`, as in training/common/even_draws.py; shift: of the earlier draws."""
    return start.to(tl.int64) + shift + number.to(tl.int64) * GOLDEN


@triton.jit
def _unit(bits):
    """0 <= x < 1 from 32 random bits."""
    # 2^-24: a float32 holds 24 bits exactly, while 32 could round up to 1.
    return (bits.to(tl.uint32) >> 8).to(tl.float32) * 5.9604644775390625e-08


@triton.jit
def view_of(index, view_ends, views, STEPS: tl.constexpr):
    """The view (int32) that contains pixel `index`, counted across all views: the first whose end is beyond it."""
    low = (index * 0).to(tl.int32)
    high = low + views - 1
    for _ in tl.static_range(STEPS):
        middle = (low + high) // 2
        beyond = tl.load(view_ends + middle) > index
        high = tl.where(beyond, middle, high)
        # min: once both have met, the remaining steps must not move on.
        low = tl.where(beyond, low, tl.minimum(middle + 1, high))
    return low


@triton.jit
def ray_of_pixel(
    index, view, view_ends, view_sizes, widths, intrinsics, poses, bytes_, codes, CHANNELS: tl.constexpr, mask
):  # fmt: skip
    """(origin, direction, rgba) of pixel `index`, counted across all views; codes [views, 256]: colors of bytes."""
    v = view.to(tl.int64)
    width = tl.load(widths + v)
    pixel = index - tl.load(view_ends + v) + tl.load(view_sizes + v)
    x = ((pixel % width).to(tl.float32) + 0.5 - tl.load(intrinsics + v * 4 + 2)) / tl.load(intrinsics + v * 4)
    y = ((pixel // width).to(tl.float32) + 0.5 - tl.load(intrinsics + v * 4 + 3)) / tl.load(intrinsics + v * 4 + 1)
    norm = 1.0 / tl.sqrt(x * x + y * y + 1.0)
    row = poses + v * 12
    dx = (tl.load(row) * x + tl.load(row + 1) * y + tl.load(row + 2)) * norm
    dy = (tl.load(row + 4) * x + tl.load(row + 5) * y + tl.load(row + 6)) * norm
    dz = (tl.load(row + 8) * x + tl.load(row + 9) * y + tl.load(row + 10)) * norm
    at = offset(index, CHANNELS, 0)
    own = codes + v * 256
    red = tl.load(own + tl.load(bytes_ + at, mask=mask, other=0).to(tl.int32))
    green = tl.load(own + tl.load(bytes_ + at + 1, mask=mask, other=0).to(tl.int32))
    blue = tl.load(own + tl.load(bytes_ + at + 2, mask=mask, other=0).to(tl.int32))
    alpha = red * 0.0 + 1.0
    if CHANNELS == 4:
        alpha = tl.load(bytes_ + at + 3, mask=mask, other=0).to(tl.float32) * 0.00392156862745098  # 1 / 255
    return tl.load(row + 3), tl.load(row + 7), tl.load(row + 11), dx, dy, dz, red, green, blue, alpha


@triton.jit
def _store_ray(origins, directions, wanted, at, ox, oy, oz, dx, dy, dz, red, green, blue, alpha, mask):
    store_vector(origins, at, ox, oy, oz, mask)
    store_vector(directions, at, dx, dy, dz, mask)
    rgba = wanted + offset(at, 4, 0)
    tl.store(rgba, red, mask=mask)
    tl.store(rgba + 1, green, mask=mask)
    tl.store(rgba + 2, blue, mask=mask)
    tl.store(rgba + 3, alpha, mask=mask)


@triton.jit(do_not_specialize=["count", "views"])
def rays_kernel(
    chosen, count, view_ends, view_sizes, views, widths, intrinsics, poses, bytes_, codes, origins, directions, wanted,
    CHANNELS: tl.constexpr, STEPS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Rays and straight (not premultiplied) rgba of pixels `chosen` [count] int64, counted across all views."""
    k = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    mask = k < count
    index = tl.load(chosen + k, mask=mask, other=0)
    view = view_of(index, view_ends, views, STEPS)
    ox, oy, oz, dx, dy, dz, red, green, blue, alpha = ray_of_pixel(
        index, view, view_ends, view_sizes, widths, intrinsics, poses, bytes_, codes, CHANNELS, mask
    )
    _store_ray(origins, directions, wanted, k, ox, oy, oz, dx, dy, dz, red, green, blue, alpha, mask)


NOT_SPECIALIZED = ["seed", "sequence", "shift", "lit_shift", "first", "rays", "total", "lit_total", "lit_rays", "views"]


@triton.jit(do_not_specialize=NOT_SPECIALIZED)
def draw_kernel(
    seed, sequence, shift, lit_shift, first, rays, total, lit, lit_total, lit_rays, view_ends, view_sizes, views,
    widths, intrinsics, poses, bytes_, codes, level, origins, directions, wanted, jitter, background,
    CHANNELS: tl.constexpr, RANDOM_BACKGROUND: tl.constexpr, STEPS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Rays `first` .. `first` + rays of a batch, independent of how the batch is split.

    Pixels continue `sequence` after the draws represented by the shifts; `seed` is for jitter and background. The
    batch's first lit_rays rays draw a pixel from lit[0:lit_total], the others one from 0..total. level: gray level of
    the background if it is not random.
    """
    local = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    mask = local < rays
    number = local + first
    # Two counters a ray, of four words each; numbered within the batch, not within this part of it.
    _a, _b, c, _d = tl.randint4x(seed, number * 2)
    r0, r1, r2, _r3 = tl.randint4x(seed, number * 2 + 1)
    start, lit_start, _s2, _s3 = tl.randint4x(sequence, number * 0 - 1)  # one counter for all rays, which no ray has
    index = _below(_evenly(start, shift, number - lit_rays), total + 0 * local.to(tl.int64))
    among_lit = mask & (number < lit_rays)
    lit_place = _below(_evenly(lit_start, lit_shift, number), lit_total + 0 * local.to(tl.int64))
    index = tl.where(among_lit, tl.load(lit + lit_place, mask=among_lit, other=0).to(tl.int64), index)
    view = view_of(index, view_ends, views, STEPS)
    ox, oy, oz, dx, dy, dz, red, green, blue, alpha = ray_of_pixel(
        index, view, view_ends, view_sizes, widths, intrinsics, poses, bytes_, codes, CHANNELS, mask
    )
    _store_ray(origins, directions, wanted, local, ox, oy, oz, dx, dy, dz, red, green, blue, alpha, mask)
    tl.store(jitter + local, _unit(c), mask=mask)
    if RANDOM_BACKGROUND:
        store_vector(background, local, _unit(r0), _unit(r1), _unit(r2), mask)
    else:
        gray = level + 0.0 * dx
        store_vector(background, local, gray, gray, gray, mask)
