"""Color heads without a hidden layer, behind any encoder: kernels/cpu/color_heads.py, features and head in one kernel.

Samples are walked as in vm.py; features never leave the registers. All heads' kernels take the same arguments: ENCODER,
PIECES, RANK and WIDTH say what the features are (encoders.py); UNITS: columns of the layer behind them, here 3 BANDS
rounded up to a power of two, at least 16.
"""

import triton
import triton.language as tl

from stylerf.kernels.gpu.encoders import piece, piece_scatter, to_color, to_learn
from stylerf.kernels.gpu.indexing import offset, store_vector, vector
from stylerf.kernels.gpu.spherical_harmonics import bands_of
from stylerf.kernels.gpu.vm import SIZES, _channel, _sigmoid

UNALIGNED = ["numbers", "numbers_to"]


@triton.jit
def _rows(head, m: tl.constexpr, columns, output, RANK: tl.constexpr, FEATURES: tl.constexpr, OUTPUTS: tl.constexpr):
    """[UNITS, WIDTH]: the head's weights of piece m, an output for every channel and band; zero beyond."""
    mask = (output[:, None] < OUTPUTS) & (columns[None, :] < RANK)
    return tl.load(head + output[:, None] * FEATURES + m * RANK + columns[None, :], mask=mask, other=0.0)


@triton.jit
def _of_channel(output, g0, g1, g2, BANDS: tl.constexpr):
    """[samples, columns]: each column's channel's gradient; zero beyond 3 BANDS columns."""
    channel = (output // BANDS)[None, :]
    own = tl.where(channel == 0, g0[:, None], tl.where(channel == 1, g1[:, None], g2[:, None]))
    return tl.where(output[None, :] < 3 * BANDS, own, 0.0)


@triton.jit(do_not_specialize=SIZES, do_not_specialize_on_alignment=["numbers"])
def linear_kernel(
    table, layout, numbers, points, directions, ray_of, weights, largest, weight_threshold, total, out, s0, s1, s2,
    ENCODER: tl.constexpr, PIECES: tl.constexpr, RANK: tl.constexpr, WIDTH: tl.constexpr, BANDS: tl.constexpr,
    UNITS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """out [n, 3]: sigmoid(bias + sum_b Y_b head_b . phi); -1 below weight_threshold times the ray's largest weight."""
    count = tl.load(total)
    columns, output = tl.arange(0, WIDTH), tl.arange(0, UNITS)
    bias = numbers + 3 * BANDS * PIECES * RANK
    for block in range(tl.program_id(0).to(tl.int64), tl.cdiv(count, BLOCK), tl.num_programs(0)):
        k = block * BLOCK + tl.arange(0, BLOCK)
        inside, valid, ray = to_color(k, count, ray_of, weights, largest, weight_threshold)
        if tl.max(valid.to(tl.int32), axis=0) > 0:
            x, y, z = vector(points, k, valid)
            sums = tl.zeros([BLOCK, UNITS], tl.float32)
            for m in tl.static_range(PIECES):
                phi = piece(m, table, layout, x, y, z, s0, s1, s2, columns, valid, ENCODER, RANK)
                rows = _rows(numbers, m, columns, output, RANK, PIECES * RANK, 3 * BANDS)
                sums = tl.dot(phi, tl.trans(rows), acc=sums, input_precision="ieee")
            dx, dy, dz = vector(directions, ray, valid)
            sums = sums * bands_of(dx, dy, dz, output, BANDS)
            red = _sigmoid(_channel(sums, output, BANDS, 0) + tl.load(bias))
            green = _sigmoid(_channel(sums, output, BANDS, 1) + tl.load(bias + 1))
            blue = _sigmoid(_channel(sums, output, BANDS, 2) + tl.load(bias + 2))
            store_vector(out, k, red, green, blue, valid)
        tl.store(out + offset(k, 3, 0), -1.0, mask=inside & (valid == 0))


@triton.jit(do_not_specialize=SIZES, do_not_specialize_on_alignment=UNALIGNED)
def linear_backward_kernel(
    table, layout, numbers, points, directions, ray_of, colors, color_gradients, total, to, numbers_to, s0, s1, s2,
    ENCODER: tl.constexpr, PIECES: tl.constexpr, RANK: tl.constexpr, WIDTH: tl.constexpr, BANDS: tl.constexpr,
    UNITS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Add dL/d(table) and dL/d(head, bias) to their buffers; samples with colors[k, 0] < 0 are skipped."""
    count = tl.load(total)
    columns, output = tl.arange(0, WIDTH), tl.arange(0, UNITS)
    # Every sample speaks to the head: a program adds up its own samples first.
    head0 = tl.zeros([UNITS, WIDTH], tl.float32)
    head1 = tl.zeros([UNITS, WIDTH], tl.float32)
    head2 = tl.zeros([UNITS, WIDTH], tl.float32)
    red, green, blue = 0.0, 0.0, 0.0
    for block in range(tl.program_id(0).to(tl.int64), tl.cdiv(count, BLOCK), tl.num_programs(0)):
        k = block * BLOCK + tl.arange(0, BLOCK)
        valid, ray, g0, g1, g2 = to_learn(k, count, ray_of, colors, color_gradients)
        red += tl.sum(g0, axis=0)
        green += tl.sum(g1, axis=0)
        blue += tl.sum(g2, axis=0)
        x, y, z = vector(points, k, valid)
        dx, dy, dz = vector(directions, ray, valid)
        own = _of_channel(output, g0, g1, g2, BANDS) * bands_of(dx, dy, dz, output, BANDS)
        for m in tl.static_range(PIECES):
            phi = piece(m, table, layout, x, y, z, s0, s1, s2, columns, valid, ENCODER, RANK)
            rows = _rows(numbers, m, columns, output, RANK, PIECES * RANK, 3 * BANDS)
            gradient = tl.dot(own, rows, input_precision="ieee")
            piece_scatter(m, table, to, layout, x, y, z, s0, s1, s2, gradient, columns, valid, ENCODER, RANK)
            if m == 0:
                head0 = tl.dot(tl.trans(own), phi, acc=head0, input_precision="ieee")
            elif m == 1:
                head1 = tl.dot(tl.trans(own), phi, acc=head1, input_precision="ieee")
            else:
                head2 = tl.dot(tl.trans(own), phi, acc=head2, input_precision="ieee")
    at = numbers_to + output[:, None] * (PIECES * RANK) + columns[None, :]
    mask = (output[:, None] < 3 * BANDS) & (columns[None, :] < RANK)
    tl.atomic_add(at, head0, mask=mask, sem="relaxed")
    if PIECES == 3:
        tl.atomic_add(at + RANK, head1, mask=mask, sem="relaxed")
        tl.atomic_add(at + 2 * RANK, head2, mask=mask, sem="relaxed")
    bias_to = numbers_to + 3 * BANDS * PIECES * RANK
    tl.atomic_add(bias_to, red, sem="relaxed")
    tl.atomic_add(bias_to + 1, green, sem="relaxed")
    tl.atomic_add(bias_to + 2, blue, sem="relaxed")


@triton.jit(do_not_specialize=SIZES, do_not_specialize_on_alignment=["numbers"])
def harmonic_kernel(
    table, layout, numbers, points, directions, ray_of, weights, largest, weight_threshold, total, out, s0, s1, s2,
    ENCODER: tl.constexpr, PIECES: tl.constexpr, RANK: tl.constexpr, WIDTH: tl.constexpr, BANDS: tl.constexpr,
    UNITS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """out [n, 3]: sigmoid(sum_b Y_b phi_b) of features that are coefficients, [3, BANDS]; numbers: not read."""
    count = tl.load(total)
    columns = tl.arange(0, WIDTH)
    for block in range(tl.program_id(0).to(tl.int64), tl.cdiv(count, BLOCK), tl.num_programs(0)):
        k = block * BLOCK + tl.arange(0, BLOCK)
        inside, valid, ray = to_color(k, count, ray_of, weights, largest, weight_threshold)
        if tl.max(valid.to(tl.int32), axis=0) > 0:
            x, y, z = vector(points, k, valid)
            dx, dy, dz = vector(directions, ray, valid)
            phi = piece(0, table, layout, x, y, z, s0, s1, s2, columns, valid, ENCODER, RANK)
            seen = phi * bands_of(dx, dy, dz, columns, BANDS)
            red = _sigmoid(_channel(seen, columns, BANDS, 0))
            green = _sigmoid(_channel(seen, columns, BANDS, 1))
            blue = _sigmoid(_channel(seen, columns, BANDS, 2))
            store_vector(out, k, red, green, blue, valid)
        tl.store(out + offset(k, 3, 0), -1.0, mask=inside & (valid == 0))


@triton.jit(do_not_specialize=SIZES, do_not_specialize_on_alignment=UNALIGNED)
def harmonic_backward_kernel(
    table, layout, numbers, points, directions, ray_of, colors, color_gradients, total, to, numbers_to, s0, s1, s2,
    ENCODER: tl.constexpr, PIECES: tl.constexpr, RANK: tl.constexpr, WIDTH: tl.constexpr, BANDS: tl.constexpr,
    UNITS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Add dL/d(table); samples with colors[k, 0] < 0 are skipped."""
    count = tl.load(total)
    columns = tl.arange(0, WIDTH)
    for block in range(tl.program_id(0).to(tl.int64), tl.cdiv(count, BLOCK), tl.num_programs(0)):
        k = block * BLOCK + tl.arange(0, BLOCK)
        valid, ray, g0, g1, g2 = to_learn(k, count, ray_of, colors, color_gradients)
        x, y, z = vector(points, k, valid)
        dx, dy, dz = vector(directions, ray, valid)
        own = _of_channel(columns, g0, g1, g2, BANDS) * bands_of(dx, dy, dz, columns, BANDS)
        piece_scatter(0, table, to, layout, x, y, z, s0, s1, s2, own, columns, valid, ENCODER, RANK)
