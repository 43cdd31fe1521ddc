"""encode, vm: kernels/cpu/vm.py on tiles of samples by ranks, forward and backward.

A program takes BLOCK samples at a time and walks the packed list with a stride of all programs, so that the number of
samples need not be known where the kernel is launched. WIDTH: the rank rounded up to a power of two, at least 16.
"""

import triton
import triton.language as tl

from stylerf.kernels.gpu.indexing import cell, offset, vector
from stylerf.kernels.gpu.spherical_harmonics import bands_of

EXPONENT_MIN, EXPONENT_MAX = tl.constexpr(-15.0), tl.constexpr(12.0)
# A kernel compiled for every size that is a multiple of sixteen, and again for the others, gains nothing by it.
SIZES = ["s0", "s1", "s2"]


@triton.jit
def place(m: tl.constexpr, x, y, z, s0, s1, s2):
    """Rows of plane m and of its line at a point: (upper, lower plane row, line row: int64, fu, fv, fw)."""
    planes = s0.to(tl.int64) * s1 + s1.to(tl.int64) * s2 + s2.to(tl.int64) * s0
    if m == 0:
        u, v, w, su, sv, sw = y, z, x, s1, s2, s0
        before, lines = planes * 0, planes
    elif m == 1:
        u, v, w, su, sv, sw = z, x, y, s2, s0, s1
        before, lines = s1.to(tl.int64) * s2, planes + s0
    else:
        u, v, w, su, sv, sw = x, y, z, s0, s1, s2
        before, lines = s1.to(tl.int64) * s2 + s2.to(tl.int64) * s0, planes + s0 + s1
    iu, fu = cell(u, su)
    iv, fv = cell(v, sv)
    iw, fw = cell(w, sw)
    first = before + iu.to(tl.int64) * sv + iv
    return first, first + sv, lines + iw, fu[:, None], fv[:, None], fw[:, None]


@triton.jit
def tile(table, row, columns, RANK: tl.constexpr, mask):
    """Rows of the table as float32 [samples, WIDTH]; the table may hold halves."""
    at = offset(row[:, None], RANK, columns[None, :])
    return tl.load(table + at, mask=mask, other=0.0).to(tl.float32)


@triton.jit
def product(table, first, second, line, fu, fv, fw, columns, RANK: tl.constexpr, mask):
    """(plane, line) [samples, WIDTH]: bilinear and linear mixes; their product is the plane's feature."""
    upper = (1.0 - fv) * tile(table, first, columns, RANK, mask) + fv * tile(table, first + 1, columns, RANK, mask)
    lower = (1.0 - fv) * tile(table, second, columns, RANK, mask) + fv * tile(table, second + 1, columns, RANK, mask)
    along = (1.0 - fw) * tile(table, line, columns, RANK, mask) + fw * tile(table, line + 1, columns, RANK, mask)
    return (1.0 - fu) * upper + fu * lower, along


@triton.jit
def scatter(to, first, second, line, fu, fv, fw, plane, along, gradient, columns, RANK: tl.constexpr, mask):
    """Add gradient [samples, WIDTH] times d(plane * along) to the rows of `to`, laid out as the table."""
    dp, dl = gradient * along, gradient * plane
    upper, lower, ends = first[:, None], second[:, None], line[:, None]
    at = columns[None, :]
    tl.atomic_add(to + offset(upper, RANK, at), (1.0 - fu) * (1.0 - fv) * dp, mask=mask, sem="relaxed")
    tl.atomic_add(to + offset(upper + 1, RANK, at), (1.0 - fu) * fv * dp, mask=mask, sem="relaxed")
    tl.atomic_add(to + offset(lower, RANK, at), fu * (1.0 - fv) * dp, mask=mask, sem="relaxed")
    tl.atomic_add(to + offset(lower + 1, RANK, at), fu * fv * dp, mask=mask, sem="relaxed")
    tl.atomic_add(to + offset(ends, RANK, at), (1.0 - fw) * dl, mask=mask, sem="relaxed")
    tl.atomic_add(to + offset(ends + 1, RANK, at), fw * dl, mask=mask, sem="relaxed")


@triton.jit
def raw_density(table, shift, x, y, z, s0, s1, s2, valid, RANK: tl.constexpr, WIDTH: tl.constexpr):
    """exp(shift + features) of points; shift: pointer."""
    columns = tl.arange(0, WIDTH)
    mask = valid[:, None] & (columns[None, :] < RANK)
    total = x * 0.0 + tl.load(shift)
    for m in tl.static_range(3):
        first, second, line, fu, fv, fw = place(m, x, y, z, s0, s1, s2)
        plane, along = product(table, first, second, line, fu, fv, fw, columns, RANK, mask)
        total += tl.sum(plane * along, axis=1)
    return tl.exp(tl.minimum(tl.maximum(total, EXPONENT_MIN), EXPONENT_MAX))


@triton.jit(do_not_specialize=[*SIZES, "count"], do_not_specialize_on_alignment=["shift"])
def density_kernel(
    table, shift, points, sigma, count, s0, s1, s2, RANK: tl.constexpr, WIDTH: tl.constexpr, BLOCK: tl.constexpr
):
    """sigma[k] of points [count, 3]."""
    k = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    valid = k < count
    x, y, z = vector(points, k, valid)
    tl.store(sigma + k, raw_density(table, shift, x, y, z, s0, s1, s2, valid, RANK, WIDTH), mask=valid)


@triton.jit(do_not_specialize=SIZES, do_not_specialize_on_alignment=["shift_to"])
def density_backward_kernel(
    table, points, sigma, sigma_gradients, total, to, shift_to, s0, s1, s2,
    RANK: tl.constexpr, WIDTH: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Add dL/d(table) to `to` and dL/d(shift) to shift_to[0]; total: pointer to the number of samples."""
    count = tl.load(total)
    columns = tl.arange(0, WIDTH)
    for block in range(tl.program_id(0).to(tl.int64), tl.cdiv(count, BLOCK), tl.num_programs(0)):
        k = block * BLOCK + tl.arange(0, BLOCK)
        inside = k < count
        g = tl.load(sigma_gradients + k, mask=inside, other=0.0) * tl.load(sigma + k, mask=inside, other=0.0)
        valid = inside & (g != 0.0)
        x, y, z = vector(points, k, valid)
        mask = valid[:, None] & (columns[None, :] < RANK)
        tl.atomic_add(shift_to, tl.sum(tl.where(valid, g, 0.0), axis=0), sem="relaxed")
        for m in tl.static_range(3):
            first, second, line, fu, fv, fw = place(m, x, y, z, s0, s1, s2)
            plane, along = product(table, first, second, line, fu, fv, fw, columns, RANK, mask)
            scatter(to, first, second, line, fu, fv, fw, plane, along, g[:, None], columns, RANK, mask)


@triton.jit
def head_rows(head, m: tl.constexpr, columns, RANK: tl.constexpr, BANDS: tl.constexpr, OUTPUTS: tl.constexpr):
    """[OUTPUTS, WIDTH]: the head's weights of plane m, an output for every channel and band; zero beyond."""
    output = tl.arange(0, OUTPUTS)
    mask = (output[:, None] < 3 * BANDS) & (columns[None, :] < RANK)
    return tl.load(head + output[:, None] * (3 * RANK) + m * RANK + columns[None, :], mask=mask, other=0.0)


@triton.jit
def _channel(values, output, BANDS: tl.constexpr, j: tl.constexpr):
    """Sum of the columns of [samples, OUTPUTS] that belong to channel j."""
    own = (output >= j * BANDS) & (output < (j + 1) * BANDS)
    return tl.sum(tl.where(own[None, :], values, 0.0), axis=1)


@triton.jit
def _sigmoid(z):
    return 1.0 / (1.0 + tl.exp(-z))


@triton.jit(do_not_specialize=SIZES, do_not_specialize_on_alignment=["head", "bias"])
def color_kernel(
    table, head, bias, points, directions, ray_of, weights, largest, weight_threshold, total, out, s0, s1, s2,
    RANK: tl.constexpr, WIDTH: tl.constexpr, BANDS: tl.constexpr, OUTPUTS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """out [n, 3]: colors; -1 in channel 0 of samples below weight_threshold times their ray's largest weight.

    OUTPUTS: 3 BANDS rounded up to a power of two, at least 16.
    """
    count = tl.load(total)
    columns, output = tl.arange(0, WIDTH), tl.arange(0, OUTPUTS)
    for block in range(tl.program_id(0).to(tl.int64), tl.cdiv(count, BLOCK), tl.num_programs(0)):
        k = block * BLOCK + tl.arange(0, BLOCK)
        inside = k < count
        ray = tl.load(ray_of + k, mask=inside, other=0)
        w = tl.load(weights + k, mask=inside, other=0.0)
        valid = inside & (w > 0.0) & (w >= weight_threshold * tl.load(largest + ray, mask=inside, other=0.0))
        if tl.max(valid.to(tl.int32), axis=0) > 0:
            x, y, z = vector(points, k, valid)
            mask = valid[:, None] & (columns[None, :] < RANK)
            sums = tl.zeros([BLOCK, OUTPUTS], tl.float32)
            for m in tl.static_range(3):
                first, second, line, fu, fv, fw = place(m, x, y, z, s0, s1, s2)
                plane, along = product(table, first, second, line, fu, fv, fw, columns, RANK, mask)
                rows = head_rows(head, m, columns, RANK, BANDS, OUTPUTS)
                sums = tl.dot(plane * along, tl.trans(rows), acc=sums, input_precision="ieee")
            dx, dy, dz = vector(directions, ray, valid)
            sums = sums * bands_of(dx, dy, dz, output, BANDS)
            red = _sigmoid(_channel(sums, output, BANDS, 0) + tl.load(bias))
            green = _sigmoid(_channel(sums, output, BANDS, 1) + tl.load(bias + 1))
            blue = _sigmoid(_channel(sums, output, BANDS, 2) + tl.load(bias + 2))
            at = offset(k, 3, 0)
            tl.store(out + at, red, mask=valid)
            tl.store(out + at + 1, green, mask=valid)
            tl.store(out + at + 2, blue, mask=valid)
        tl.store(out + offset(k, 3, 0), -1.0, mask=inside & (valid == 0))


@triton.jit(do_not_specialize=SIZES, do_not_specialize_on_alignment=["head", "head_to", "bias_to"])
def color_backward_kernel(
    table, head, points, directions, ray_of, colors, color_gradients, total, to, head_to, bias_to, s0, s1, s2,
    RANK: tl.constexpr, WIDTH: tl.constexpr, BANDS: tl.constexpr, OUTPUTS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Add dL/d(table), dL/d(head), dL/d(bias) to their buffers; samples with colors[k, 0] < 0 are skipped."""
    count = tl.load(total)
    columns, output = tl.arange(0, WIDTH), tl.arange(0, OUTPUTS)
    # The head is small and every sample speaks to it: a program adds up its own samples first.
    head0 = tl.zeros([OUTPUTS, WIDTH], tl.float32)
    head1 = tl.zeros([OUTPUTS, WIDTH], tl.float32)
    head2 = tl.zeros([OUTPUTS, WIDTH], tl.float32)
    red, green, blue = 0.0, 0.0, 0.0
    for block in range(tl.program_id(0).to(tl.int64), tl.cdiv(count, BLOCK), tl.num_programs(0)):
        k = block * BLOCK + tl.arange(0, BLOCK)
        inside = k < count
        c0 = tl.load(colors + offset(k, 3, 0), mask=inside, other=-1.0)
        valid = c0 >= 0.0
        ray = tl.load(ray_of + k, mask=valid, other=0)
        c0, c1, c2 = vector(colors, k, valid)
        g0, g1, g2 = vector(color_gradients, k, valid)
        g0, g1, g2 = g0 * c0 * (1.0 - c0), g1 * c1 * (1.0 - c1), g2 * c2 * (1.0 - c2)
        red += tl.sum(g0, axis=0)
        green += tl.sum(g1, axis=0)
        blue += tl.sum(g2, axis=0)
        x, y, z = vector(points, k, valid)
        dx, dy, dz = vector(directions, ray, valid)
        channel = output // BANDS
        own = tl.where(channel == 0, g0[:, None], tl.where(channel == 1, g1[:, None], g2[:, None]))
        own = tl.where(output[None, :] < 3 * BANDS, own, 0.0) * bands_of(dx, dy, dz, output, BANDS)
        mask = valid[:, None] & (columns[None, :] < RANK)
        for m in tl.static_range(3):
            first, second, line, fu, fv, fw = place(m, x, y, z, s0, s1, s2)
            plane, along = product(table, first, second, line, fu, fv, fw, columns, RANK, mask)
            rows = head_rows(head, m, columns, RANK, BANDS, OUTPUTS)
            gradient = tl.dot(own, rows, input_precision="ieee")
            scatter(to, first, second, line, fu, fv, fw, plane, along, gradient, columns, RANK, mask)
            if m == 0:
                head0 = tl.dot(tl.trans(own), plane * along, acc=head0, input_precision="ieee")
            elif m == 1:
                head1 = tl.dot(tl.trans(own), plane * along, acc=head1, input_precision="ieee")
            else:
                head2 = tl.dot(tl.trans(own), plane * along, acc=head2, input_precision="ieee")
    at = output[:, None] * (3 * RANK) + columns[None, :]
    mask = (output[:, None] < 3 * BANDS) & (columns[None, :] < RANK)
    tl.atomic_add(head_to + at, head0, mask=mask, sem="relaxed")
    tl.atomic_add(head_to + at + RANK, head1, mask=mask, sem="relaxed")
    tl.atomic_add(head_to + at + 2 * RANK, head2, mask=mask, sem="relaxed")
    tl.atomic_add(bias_to, red, sem="relaxed")
    tl.atomic_add(bias_to + 1, green, sem="relaxed")
    tl.atomic_add(bias_to + 2, blue, sem="relaxed")


@triton.jit(do_not_specialize=["rows", "columns", "begin"])
def smoothness_kernel(
    table, to, strength, rows, columns, begin, RANK: tl.constexpr, WIDTH: tl.constexpr, BLOCK: tl.constexpr
):
    """Add strength * d/dt of half the summed squared differences of neighboring texels of one plane to `to`.

    begin: the plane's first row of the table; one texel to a row of the tile.
    """
    n = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    rank = tl.arange(0, WIDTH)
    i, j = n // columns, n % columns
    valid = (n < rows.to(tl.int64) * columns)[:, None] & (rank[None, :] < RANK)
    here = tile(table, begin + n, rank, RANK, valid)
    total = here * 0.0
    for side in tl.static_range(4):
        if side == 0:
            there, known = n - columns, i > 0
        elif side == 1:
            there, known = n + columns, i < rows - 1
        elif side == 2:
            there, known = n - 1, j > 0
        else:
            there, known = n + 1, j < columns - 1
        both = valid & known[:, None]
        total += tl.where(both, here - tile(table, begin + there, rank, RANK, both), 0.0)
    at = to + offset((begin + n)[:, None], RANK, rank[None, :])
    tl.store(at, tl.load(at, mask=valid, other=0.0) + strength * total, mask=valid)
