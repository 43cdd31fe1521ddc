"""Color heads on features of any kind (kernels/cpu/color_heads.py), with features and head in one kernel.

    linear    sigmoid(bias + sum_b Y_b head_b . phi); numbers: head [3, BANDS, PIECES RANK], bias [3]
    harmonic  sigmoid(sum_b Y_b phi_b) for features that are coefficients, [3, BANDS]; numbers: not read
    mlp       sigmoid(W2 relu(W1 (phi, Y) + b1) + b2); numbers, flat: W1 of the features [PIECES RANK, UNITS], W1 of
              the harmonics [BANDS, UNITS], b1 [UNITS], W2 [3, UNITS], b2 [3]

Samples are processed as in tables.py; features never leave registers. ENCODER, PIECES, RANK and WIDTH define the
features. UNITS: size of the hidden layer, a power of two; without one, 3 BANDS rounded up to a power of two, at least
16.
"""

import triton
import triton.language as tl

from stylerf.kernels.gpu.indexing import SIZES, offset, store_vector, vector
from stylerf.kernels.gpu.shading import bands_of, of_channel, sigmoid, sum_of_channel, to_color, to_learn
from stylerf.kernels.gpu.tables import piece, piece_scatter

LINEAR, HARMONIC, MLP = tl.constexpr(0), tl.constexpr(1), tl.constexpr(2)
# Slices that begin anywhere in a part's values: Triton would compile again for those that happen to be aligned.
UNALIGNED = ["numbers", "numbers_to"]
MOST_BANDS = tl.constexpr(16)  # columns of the tile of harmonics: products of tiles need as many


@triton.jit
def head_rows(
    head, m: tl.constexpr, columns, output, RANK: tl.constexpr, FEATURES: tl.constexpr, OUTPUTS: tl.constexpr
):  # fmt: skip
    """[UNITS, WIDTH]: the head's weights for piece m, one output per channel and band; zero beyond."""
    mask = (output[:, None] < OUTPUTS) & (columns[None, :] < RANK)
    return tl.load(head + output[:, None] * FEATURES + m * RANK + columns[None, :], mask=mask, other=0.0)


@triton.jit
def _first_rows(numbers, first: tl.constexpr, place, COUNT: tl.constexpr, UNITS: tl.constexpr):
    """[places, UNITS]: the rows of W1 from `first` on; zero from the COUNTth on."""
    at = numbers + (first + place[:, None]) * UNITS + tl.arange(0, UNITS)[None, :]
    return tl.load(at, mask=place[:, None] < COUNT, other=0.0)


@triton.jit
def _from_direction(numbers, basis, band, FEATURES: tl.constexpr, BANDS: tl.constexpr, UNITS: tl.constexpr):
    """[samples, UNITS]: b1 + sum_b Y_b W1_b."""
    # ieee here and below: by default tl.dot may round float32 to TF32, which keeps ten bits of the fraction.
    sums = tl.dot(basis, _first_rows(numbers, FEATURES, band, BANDS, UNITS), input_precision="ieee")
    return sums + tl.load(numbers + (FEATURES + BANDS) * UNITS + tl.arange(0, UNITS))[None, :]


@triton.jit
def hidden_layer(
    numbers, table, layout, x, y, z, s0, s1, s2, basis, band, columns, valid,
    ENCODER: tl.constexpr, PIECES: tl.constexpr, RANK: tl.constexpr, BANDS: tl.constexpr, UNITS: tl.constexpr,
):  # fmt: skip
    """(relu(W1 (phi, Y) + b1) [samples, UNITS], the last piece of phi); propagates NaN."""
    sums = _from_direction(numbers, basis, band, PIECES * RANK, BANDS, UNITS)
    for m in tl.static_range(PIECES):
        phi = piece(m, table, layout, x, y, z, s0, s1, s2, columns, valid, ENCODER, RANK)
        rows = _first_rows(numbers, m * RANK, columns, RANK, UNITS)
        sums = tl.dot(phi, rows, acc=sums, input_precision="ieee")
    # tl.maximum would turn a NaN into 0.
    return tl.where(sums < 0.0, 0.0, sums), phi


@triton.jit(do_not_specialize=SIZES, do_not_specialize_on_alignment=["numbers"])
def color_kernel(
    table, layout, numbers, points, directions, ray_of, weights, largest, weight_threshold, total, out, s0, s1, s2,
    HEAD: tl.constexpr, ENCODER: tl.constexpr, PIECES: tl.constexpr, RANK: tl.constexpr, WIDTH: tl.constexpr,
    BANDS: tl.constexpr, UNITS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """out [n, 3]: colors; -1 in channel 0 for samples below weight_threshold times their ray's largest weight."""
    count = tl.load(total)
    columns, unit = tl.arange(0, WIDTH), tl.arange(0, UNITS)
    for block in range(tl.program_id(0).to(tl.int64), tl.cdiv(count, BLOCK), tl.num_programs(0)):
        k = block * BLOCK + tl.arange(0, BLOCK)
        inside, valid, ray = to_color(k, count, ray_of, weights, largest, weight_threshold)
        # A block without a visible sample reads no table.
        if tl.max(valid.to(tl.int32), axis=0) > 0:
            x, y, z = vector(points, k, valid)
            dx, dy, dz = vector(directions, ray, valid)
            if HEAD == MLP:
                band = tl.arange(0, MOST_BANDS)
                layer, _phi = hidden_layer(
                    numbers, table, layout, x, y, z, s0, s1, s2, bands_of(dx, dy, dz, band, BANDS), band, columns,
                    valid, ENCODER, PIECES, RANK, BANDS, UNITS,
                )  # fmt: skip
                second = numbers + (PIECES * RANK + BANDS + 1) * UNITS
                bias = second + 3 * UNITS
                red = tl.sum(layer * tl.load(second + unit)[None, :], axis=1) + tl.load(bias)
                green = tl.sum(layer * tl.load(second + UNITS + unit)[None, :], axis=1) + tl.load(bias + 1)
                blue = tl.sum(layer * tl.load(second + 2 * UNITS + unit)[None, :], axis=1) + tl.load(bias + 2)
            elif HEAD == LINEAR:
                # An output per channel and band: head_b . phi first, then times Y_b, then summed by channel.
                sums = tl.zeros([BLOCK, UNITS], tl.float32)
                for m in tl.static_range(PIECES):
                    phi = piece(m, table, layout, x, y, z, s0, s1, s2, columns, valid, ENCODER, RANK)
                    rows = head_rows(numbers, m, columns, unit, RANK, PIECES * RANK, 3 * BANDS)
                    sums = tl.dot(phi, tl.trans(rows), acc=sums, input_precision="ieee")
                sums = sums * bands_of(dx, dy, dz, unit, BANDS)
                bias = numbers + 3 * BANDS * PIECES * RANK
                red = sum_of_channel(sums, unit, BANDS, 0) + tl.load(bias)
                green = sum_of_channel(sums, unit, BANDS, 1) + tl.load(bias + 1)
                blue = sum_of_channel(sums, unit, BANDS, 2) + tl.load(bias + 2)
            else:
                phi = piece(0, table, layout, x, y, z, s0, s1, s2, columns, valid, ENCODER, RANK)
                seen = phi * bands_of(dx, dy, dz, columns, BANDS)
                red, green = sum_of_channel(seen, columns, BANDS, 0), sum_of_channel(seen, columns, BANDS, 1)
                blue = sum_of_channel(seen, columns, BANDS, 2)
            store_vector(out, k, sigmoid(red), sigmoid(green), sigmoid(blue), valid)
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
    # One name per piece: Triton's loops carry tensors, not arrays of them.
    head0 = tl.zeros([UNITS, WIDTH], tl.float32)
    head1 = tl.zeros([UNITS, WIDTH], tl.float32)
    head2 = tl.zeros([UNITS, WIDTH], tl.float32)
    red, green, blue = 0.0, 0.0, 0.0
    for block in range(tl.program_id(0).to(tl.int64), tl.cdiv(count, BLOCK), tl.num_programs(0)):
        k = block * BLOCK + tl.arange(0, BLOCK)
        valid, g0, g1, g2 = to_learn(k, k < count, colors, color_gradients)
        ray = tl.load(ray_of + k, mask=valid, other=0)
        red += tl.sum(g0, axis=0)
        green += tl.sum(g1, axis=0)
        blue += tl.sum(g2, axis=0)
        x, y, z = vector(points, k, valid)
        dx, dy, dz = vector(directions, ray, valid)
        own = of_channel(output, g0, g1, g2, BANDS) * bands_of(dx, dy, dz, output, BANDS)
        for m in tl.static_range(PIECES):
            phi = piece(m, table, layout, x, y, z, s0, s1, s2, columns, valid, ENCODER, RANK)
            rows = head_rows(numbers, m, columns, output, RANK, PIECES * RANK, 3 * BANDS)
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
        valid, g0, g1, g2 = to_learn(k, k < count, colors, color_gradients)
        ray = tl.load(ray_of + k, mask=valid, other=0)
        x, y, z = vector(points, k, valid)
        dx, dy, dz = vector(directions, ray, valid)
        own = of_channel(columns, g0, g1, g2, BANDS) * bands_of(dx, dy, dz, columns, BANDS)
        piece_scatter(0, table, to, layout, x, y, z, s0, s1, s2, own, columns, valid, ENCODER, RANK)


@triton.jit(do_not_specialize=SIZES, do_not_specialize_on_alignment=UNALIGNED)
def mlp_backward_kernel(
    table, layout, numbers, points, directions, ray_of, colors, color_gradients, total, to, numbers_to, s0, s1, s2,
    ENCODER: tl.constexpr, PIECES: tl.constexpr, RANK: tl.constexpr, WIDTH: tl.constexpr, BANDS: tl.constexpr,
    UNITS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Add dL/d(table) and dL/d(numbers) to their buffers; samples with colors[k, 0] < 0 are skipped."""
    count = tl.load(total)
    columns, band, unit = tl.arange(0, WIDTH), tl.arange(0, MOST_BANDS), tl.arange(0, UNITS)
    second = numbers + (PIECES * RANK + BANDS + 1) * UNITS
    # Every sample speaks to the network: a program adds up its own samples first.
    of_piece0 = tl.zeros([WIDTH, UNITS], tl.float32)
    of_piece1 = tl.zeros([WIDTH, UNITS], tl.float32)
    of_piece2 = tl.zeros([WIDTH, UNITS], tl.float32)
    of_bands = tl.zeros([MOST_BANDS, UNITS], tl.float32)
    of_bias = tl.zeros([UNITS], tl.float32)
    of_red = tl.zeros([UNITS], tl.float32)
    of_green = tl.zeros([UNITS], tl.float32)
    of_blue = tl.zeros([UNITS], tl.float32)
    red, green, blue = 0.0, 0.0, 0.0
    for block in range(tl.program_id(0).to(tl.int64), tl.cdiv(count, BLOCK), tl.num_programs(0)):
        k = block * BLOCK + tl.arange(0, BLOCK)
        valid, g0, g1, g2 = to_learn(k, k < count, colors, color_gradients)
        ray = tl.load(ray_of + k, mask=valid, other=0)
        x, y, z = vector(points, k, valid)
        dx, dy, dz = vector(directions, ray, valid)
        basis = bands_of(dx, dy, dz, band, BANDS)
        layer, phi = hidden_layer(
            numbers, table, layout, x, y, z, s0, s1, s2, basis, band, columns, valid,
            ENCODER, PIECES, RANK, BANDS, UNITS,
        )  # fmt: skip
        red += tl.sum(g0, axis=0)
        green += tl.sum(g1, axis=0)
        blue += tl.sum(g2, axis=0)
        of_red += tl.sum(g0[:, None] * layer, axis=0)
        of_green += tl.sum(g1[:, None] * layer, axis=0)
        of_blue += tl.sum(g2[:, None] * layer, axis=0)
        back = g0[:, None] * tl.load(second + unit)[None, :]
        back += g1[:, None] * tl.load(second + UNITS + unit)[None, :]
        back += g2[:, None] * tl.load(second + 2 * UNITS + unit)[None, :]
        back = tl.where(layer == 0.0, 0.0, back)  # relu' is 0 at a unit that is off
        of_bias += tl.sum(back, axis=0)
        of_bands = tl.dot(tl.trans(basis), back, acc=of_bands, input_precision="ieee")
        for m in tl.static_range(PIECES):
            if PIECES > 1:  # a single piece is still loaded
                phi = piece(m, table, layout, x, y, z, s0, s1, s2, columns, valid, ENCODER, RANK)
            rows = _first_rows(numbers, m * RANK, columns, RANK, UNITS)
            gradient = tl.dot(back, tl.trans(rows), input_precision="ieee")
            piece_scatter(m, table, to, layout, x, y, z, s0, s1, s2, gradient, columns, valid, ENCODER, RANK)
            if m == 0:
                of_piece0 = tl.dot(tl.trans(phi), back, acc=of_piece0, input_precision="ieee")
            elif m == 1:
                of_piece1 = tl.dot(tl.trans(phi), back, acc=of_piece1, input_precision="ieee")
            else:
                of_piece2 = tl.dot(tl.trans(phi), back, acc=of_piece2, input_precision="ieee")
    mask = columns[:, None] < RANK
    at = numbers_to + columns[:, None] * UNITS + unit[None, :]
    tl.atomic_add(at, of_piece0, mask=mask, sem="relaxed")
    if PIECES == 3:
        tl.atomic_add(at + RANK * UNITS, of_piece1, mask=mask, sem="relaxed")
        tl.atomic_add(at + 2 * RANK * UNITS, of_piece2, mask=mask, sem="relaxed")
    at = numbers_to + (PIECES * RANK + band[:, None]) * UNITS + unit[None, :]
    tl.atomic_add(at, of_bands, mask=band[:, None] < BANDS, sem="relaxed")
    at = numbers_to + (PIECES * RANK + BANDS) * UNITS + unit
    tl.atomic_add(at, of_bias, sem="relaxed")
    tl.atomic_add(at + UNITS, of_red, sem="relaxed")
    tl.atomic_add(at + 2 * UNITS, of_green, sem="relaxed")
    tl.atomic_add(at + 3 * UNITS, of_blue, sem="relaxed")
    last = numbers_to + (PIECES * RANK + BANDS + 4) * UNITS
    tl.atomic_add(last, red, sem="relaxed")
    tl.atomic_add(last + 1, green, sem="relaxed")
    tl.atomic_add(last + 2, blue, sem="relaxed")
