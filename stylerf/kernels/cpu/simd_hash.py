"""The hash grid's gather and scatter in LLVM IR.

Indices are computed for all levels at once, one level per vector lane; then, level by level, the eight vertices around
the point, four floats each, are loaded (or accumulated) as whole rows. Compared with scalar indexing (8 levels, points
along rays, one core): forward 160 -> 100 ns per sample, backward 150 -> 100.
"""

import math

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from stylerf.kernels.cpu.simd_vm import INDEX, INT32, SCALAR, Rows, data_pointer, prefetch

ROW = 4  # floats per vertex
PRIME_X, PRIME_Y = 805459861, 2654435761 - 2**32  # as signed 32-bit numbers; z uses 1 (Mueller et al. 2022, eq. 4)


class Levels:
    """A point in every level: offsets of the eight vertices around it (x slowest, z fastest), position in the cell.

    layout: int32 [6, levels]: resolution, multiplier of x, of y, mask, first float of the level, -1 where hashed.
    row: floats per vertex.
    """

    def __init__(self, context, builder, layout, point, count: int, row: int = ROW) -> None:
        self.builder, self.count = builder, count
        self.lanes = Rows(builder, count)
        self.ints = ir.VectorType(INT32, count)
        cells, times_x, times_y, mask, first, hashed = (self._load(layout, row) for row in range(6))
        self.resolutions = builder.sitofp(cells, self.lanes.type)
        low, self.fractions = zip(*(self._split(x, cells) for x in point))
        one = self._constant(1)
        # (i + 1) times_x = i times_x + times_x holds even if 32-bit products wrap, as in the hash.
        xs = [builder.mul(low[0], times_x)]
        ys = [builder.mul(low[1], times_y)]
        xs.append(builder.add(xs[0], times_x))
        ys.append(builder.add(ys[0], times_y))
        zs = [low[2], builder.add(low[2], one)]
        self.offsets = cgutils.alloca_once(builder, self.ints, size=8)
        for corner in range(8):
            x, y, z = xs[corner >> 2], ys[(corner >> 1) & 1], zs[corner & 1]
            scrambled = builder.and_(builder.xor(builder.xor(x, y), z), mask)
            direct = builder.add(builder.add(x, y), z)
            # A bitwise select, so that direct and hashed levels share every other instruction.
            index = builder.xor(direct, builder.and_(builder.xor(direct, scrambled), hashed))
            offset = builder.add(first, builder.mul(index, self._constant(row)))
            builder.store(offset, builder.gep(self.offsets, [ir.Constant(INT32, corner)])).align = 4

    def _constant(self, value: int):
        return ir.Constant(self.ints, [value] * self.count)

    def _load(self, layout, row: int):
        address = self.builder.gep(layout, [ir.Constant(INT32, row * self.count)])
        loaded = self.builder.load(self.builder.bitcast(address, self.ints.as_pointer()))
        loaded.align = 4
        return loaded

    def _split(self, x, cells):
        """Return the lower vertex and the position in the cell; the clamp keeps even a NaN inside the table."""
        b = self.builder
        place = self.lanes.mul(self.lanes.splat(x), self.resolutions)
        index, last = b.fptosi(place, self.ints), b.sub(cells, self._constant(1))
        index = b.select(b.icmp_signed(">", index, last), last, index)
        index = b.select(b.icmp_signed("<", index, self._constant(0)), self._constant(0), index)
        return index, self.lanes.sub(place, b.sitofp(index, self.lanes.type))

    def corner_offsets(self, level: int) -> list:
        """Return the eight vertices' offsets in the table, in floats, for one level."""
        numbers = self.builder.bitcast(self.offsets, INT32.as_pointer())
        places = [ir.Constant(INT32, corner * self.count + level) for corner in range(8)]
        return [self.builder.sext(self.builder.load(self.builder.gep(numbers, [p])), ir.IntType(64)) for p in places]


def lane(builder, vector, lane: int):
    return builder.extract_element(vector, ir.Constant(INT32, lane))


def _after(builder, index, steps: int):
    return builder.add(index, ir.Constant(index.type, steps))


def _mix(rows, low, high, weight):
    """Return low + weight (high - low)."""
    return rows.fused(weight, rows.sub(high, low), low)


def interpolate(rows, values, fractions):
    """Return the trilinear interpolation of eight rows."""
    for fraction in fractions:
        # The two halves differ in the slowest remaining axis: x, then y, then z.
        half = len(values) // 2
        values = [_mix(rows, low, high, fraction) for low, high in zip(values[:half], values[half:])]
    return values[0]


def _level_rows(rows, levels, table, level):
    values = [rows.load(table, offset) for offset in levels.corner_offsets(level)]
    return values, [rows.splat(lane(rows.builder, f, level)) for f in levels.fractions]


def _scatter(rows, levels, target, level, gradient) -> None:
    """Add the shares of a gradient row for a level's eight vertices to the buffer at `target`."""
    # Backward of interpolate: each axis splits a share f into (1 - w) f and w f, in corner order.
    shares = [gradient]
    for fraction in levels.fractions:
        weight = rows.splat(lane(rows.builder, fraction, level))
        high = [rows.mul(weight, share) for share in shares]
        shares = [s for share, h in zip(shares, high) for s in (rows.sub(share, h), h)]
    for offset, share in zip(levels.corner_offsets(level), shares):
        rows.add_to(target, offset, share)


def _sigmoid(rows, z):
    """1 / (1 + 2^u), u = -z log2 e clamped to +-80; 2^u = 2^n 2^f with |f| <= 1/2, to order 7: error below 3e-7."""
    b, count = rows.builder, rows.rank
    ints = ir.VectorType(INT32, count)

    def number(value):
        return ir.Constant(rows.type, [value] * count)

    u = rows.mul(z, number(-math.log2(math.e)))
    # Keeps n + 127 a valid exponent; the sigmoid saturates long before.
    for bound, comparison in ((80.0, ">"), (-80.0, "<")):
        u = b.select(b.fcmp_ordered(comparison, u, number(bound)), number(bound), u)
    # Round to nearest: add half away from zero, then truncate.
    half = b.select(b.fcmp_ordered("<", u, number(0.0)), number(-0.5), number(0.5))
    whole = b.fptosi(b.fadd(u, half), ints)
    fraction = rows.sub(u, b.sitofp(whole, rows.type))
    # Taylor series of 2^f = exp(f ln 2), evaluated by Horner's rule.
    power = number(math.log(2) ** 7 / math.factorial(7))
    for order in range(6, -1, -1):
        power = rows.fused(power, fraction, number(math.log(2) ** order / math.factorial(order)))
    # 2^n from its bits: n + 127 in the exponent field of a float32.
    exponent = b.shl(b.add(whole, ir.Constant(ints, [127] * count)), ir.Constant(ints, [23] * count))
    power = rows.mul(power, b.bitcast(exponent, rows.type))
    return b.fdiv(number(1.0), rows.add(number(1.0), power))


def _sum(rows, terms):
    """Return the pairwise sum, which has a shorter dependency chain than eight successive additions."""
    while len(terms) > 1:
        terms = [rows.add(*pair) for pair in zip(terms[::2], terms[1::2])] + terms[len(terms) & ~1 :]
    return terms[0]


@intrinsic
def hash_prefetch(typing, table, at, layout, x, y, z, levels):
    """Prefetch the vertices of table[at:] around (x, y, z) while another point is being computed.

    Only the lower end of each edge along z: both are usually in the same cache line.
    """

    def generate(context, builder, sig, args):
        where = Levels(
            context, builder, data_pointer(context, builder, sig.args[2], args[2]), args[3:6], sig.args[-1].count
        )
        table_at = builder.gep(data_pointer(context, builder, sig.args[0], args[0]), [args[1]])
        for level in range(where.count):
            for offset in where.corner_offsets(level)[::2]:
                prefetch(builder, table_at, offset)
        return context.get_dummy_value()

    return types.void(table, INDEX, layout, SCALAR, SCALAR, SCALAR, levels), generate


@intrinsic
def hash_logits(typing, table, layout, x, y, z, out, at, levels):
    """out[at:at+3] = f[0:3] + f[3], f = sum over levels of the values interpolated at (x, y, z) in 0..1."""

    def generate(context, builder, sig, args):
        rows, count = Rows(builder, ROW), sig.args[-1].count
        pointers = [data_pointer(context, builder, sig.args[i], args[i]) for i in (0, 1, 5)]
        where = Levels(context, builder, pointers[1], args[2:5], count)
        mixed = [interpolate(rows, *_level_rows(rows, where, pointers[0], level)) for level in range(count)]
        total = _sum(rows, mixed)
        logits = rows.add(total, rows.splat(lane(builder, total, 3)))
        for channel in range(3):
            place = builder.gep(pointers[2], [_after(builder, args[6], channel)])
            builder.store(lane(builder, logits, channel), place)
        return context.get_dummy_value()

    return types.void(table, layout, SCALAR, SCALAR, SCALAR, out, INDEX, levels), generate


@intrinsic
def sigmoid_three(typing, values, at):
    """values[at:at+3] = 1 / (1 + exp(-values[at:at+3]))."""

    def generate(context, builder, sig, args):
        rows = Rows(builder, ROW)
        pointer = data_pointer(context, builder, sig.args[0], args[0])
        places = [builder.gep(pointer, [_after(builder, args[1], channel)]) for channel in range(3)]
        row = ir.Constant(rows.type, [0.0] * ROW)
        for channel, place in enumerate(places):
            row = builder.insert_element(row, builder.load(place), ir.Constant(INT32, channel))
        row = _sigmoid(rows, row)
        for channel, place in enumerate(places):
            builder.store(lane(builder, row, channel), place)
        return context.get_dummy_value()

    return types.void(values, INDEX), generate


@intrinsic
def hash_features_backward(typing, buffer, at, layout, x, y, z, gradients, row, levels):
    """Add dL/d(table) of f (see hash_logits) to buffer[at:], laid out as the table; gradients[row:row+4] = dL/df."""

    def generate(context, builder, sig, args):
        rows, count = Rows(builder, ROW), sig.args[-1].count
        where = Levels(context, builder, data_pointer(context, builder, sig.args[2], args[2]), args[3:6], count)
        target = builder.gep(data_pointer(context, builder, sig.args[0], args[0]), [args[1]])
        gradient = rows.load(data_pointer(context, builder, sig.args[6], args[6]), args[7])
        for level in range(count):
            _scatter(rows, where, target, level, gradient)
        return context.get_dummy_value()

    return types.void(buffer, INDEX, layout, SCALAR, SCALAR, SCALAR, gradients, INDEX, levels), generate


@intrinsic
def hash_rows(typing, table, layout, x, y, z, out, at, levels):
    """out[at + 4 l : at + 4 l + 4] = level l interpolated at (x, y, z) in 0..1: levels concatenated."""

    def generate(context, builder, sig, args):
        rows, count = Rows(builder, ROW), sig.args[-1].count
        pointers = [data_pointer(context, builder, sig.args[i], args[i]) for i in (0, 1, 5)]
        where = Levels(context, builder, pointers[1], args[2:5], count)
        for level in range(count):
            mixed = interpolate(rows, *_level_rows(rows, where, pointers[0], level))
            rows.store(pointers[2], _after(builder, args[6], ROW * level), mixed)
        return context.get_dummy_value()

    return types.void(table, layout, SCALAR, SCALAR, SCALAR, out, INDEX, levels), generate


@intrinsic
def hash_rows_backward(typing, buffer, at, layout, x, y, z, gradients, row, levels):
    """hash_features_backward for hash_rows: every level has its own dL/df, gradients[row + 4 l : row + 4 l + 4]."""

    def generate(context, builder, sig, args):
        rows, count = Rows(builder, ROW), sig.args[-1].count
        where = Levels(context, builder, data_pointer(context, builder, sig.args[2], args[2]), args[3:6], count)
        target = builder.gep(data_pointer(context, builder, sig.args[0], args[0]), [args[1]])
        pointer = data_pointer(context, builder, sig.args[6], args[6])
        for level in range(count):
            _scatter(rows, where, target, level, rows.load(pointer, _after(builder, args[7], ROW * level)))
        return context.get_dummy_value()

    return types.void(buffer, INDEX, layout, SCALAR, SCALAR, SCALAR, gradients, INDEX, levels), generate


def _add_slopes(rows, where, table, gradient_of, out) -> None:
    """Add sum over levels of gradient_of(level) . d(interpolated values)/d(x, y, z) to out[0:3]."""
    totals: list[list] = [[], [], []]
    for level in range(where.count):
        values, fractions = _level_rows(rows, where, table, level)
        # The slopes below are per cell; a level has `resolution` cells per cube side.
        gradient = rows.mul(gradient_of(level), rows.splat(lane(rows.builder, where.resolutions, level)))
        for axis, step in enumerate(steps(rows, values, fractions)):
            totals[axis].append(rows.mul(gradient, step))
    for axis, terms in enumerate(totals):
        place = rows.builder.gep(out, [ir.Constant(INT32, axis)])
        rows.builder.store(rows.builder.fadd(rows.builder.load(place), rows.total(_sum(rows, terms))), place)


def steps(rows, values, fractions):
    """Return the slopes of the trilinear interpolation along each axis, per cell width."""
    found = []
    for axis in range(3):
        # Earlier axes are already interpolated; the difference along this axis is interpolated along the later ones.
        half = len(values) // 2
        found.append(
            interpolate(rows, [rows.sub(h, l) for l, h in zip(values[:half], values[half:])], fractions[axis + 1 :])
        )
        values = [_mix(rows, low, high, fractions[axis]) for low, high in zip(values[:half], values[half:])]
    return found


@intrinsic
def hash_slopes(typing, table, layout, x, y, z, gradients, row, out, at, levels):
    """out[at:at+3] += dL/d(x, y, z) of f (see hash_logits); gradients[row:row+4] = dL/df."""

    def generate(context, builder, sig, args):
        rows, count = Rows(builder, ROW), sig.args[-1].count
        pointers = [data_pointer(context, builder, sig.args[i], args[i]) for i in (0, 1, 5, 7)]
        where = Levels(context, builder, pointers[1], args[2:5], count)
        gradient = rows.load(pointers[2], args[6])
        _add_slopes(rows, where, pointers[0], lambda level: gradient, builder.gep(pointers[3], [args[8]]))
        return context.get_dummy_value()

    return types.void(table, layout, SCALAR, SCALAR, SCALAR, gradients, INDEX, out, INDEX, levels), generate


@intrinsic
def hash_rows_slopes(typing, table, layout, x, y, z, gradients, row, out, at, levels):
    """hash_slopes for hash_rows: every level has its own dL/df, gradients[row + 4 l : row + 4 l + 4]."""

    def generate(context, builder, sig, args):
        rows, count = Rows(builder, ROW), sig.args[-1].count
        pointers = [data_pointer(context, builder, sig.args[i], args[i]) for i in (0, 1, 5, 7)]
        where = Levels(context, builder, pointers[1], args[2:5], count)
        _add_slopes(
            rows,
            where,
            pointers[0],
            lambda level: rows.load(pointers[2], _after(builder, args[6], ROW * level)),
            builder.gep(pointers[3], [args[8]]),
        )
        return context.get_dummy_value()

    return types.void(table, layout, SCALAR, SCALAR, SCALAR, gradients, INDEX, out, INDEX, levels), generate


# -- one float per vertex ----------------------------------------------------------------------------------------------
#
# Such short rows cannot be loaded as vectors; instead, every vector holds one corner of all levels, one level per lane,
# and the eight corners are interpolated in seven operations for any number of levels.


def _placed(context, builder, sig, layout, point, count):
    return Levels(context, builder, data_pointer(context, builder, sig, layout), point, count, row=1)


def _corners(where, table) -> list:
    """Return the values at the eight corners, each a vector over levels."""
    builder, lanes = where.builder, where.lanes
    found = [ir.Constant(lanes.type, ir.Undefined)] * 8
    for level in range(where.count):
        for corner, offset in enumerate(where.corner_offsets(level)):
            value = builder.load(builder.gep(table, [offset]))
            found[corner] = builder.insert_element(found[corner], value, ir.Constant(INT32, level))
    return found


@intrinsic
def hash_sum(typing, table, layout, x, y, z, levels):
    """Sum over levels of the values interpolated at (x, y, z) in 0..1."""

    def generate(context, builder, sig, args):
        where = _placed(context, builder, sig.args[1], args[1], args[2:5], sig.args[-1].count)
        corners = _corners(where, data_pointer(context, builder, sig.args[0], args[0]))
        return where.lanes.total(interpolate(where.lanes, corners, where.fractions))

    return types.float32(table, layout, SCALAR, SCALAR, SCALAR, levels), generate


@intrinsic
def hash_sum_backward(typing, buffer, at, layout, x, y, z, gradient, levels):
    """Add gradient * d(hash_sum)/d(table) to buffer[at:], laid out as the table."""

    def generate(context, builder, sig, args):
        where = _placed(context, builder, sig.args[2], args[2], args[3:6], sig.args[-1].count)
        target = builder.gep(data_pointer(context, builder, sig.args[0], args[0]), [args[1]])
        shares = [where.lanes.splat(args[6])]
        for fraction in where.fractions:
            high = [where.lanes.mul(fraction, share) for share in shares]
            shares = [s for share, h in zip(shares, high) for s in (where.lanes.sub(share, h), h)]
        for level in range(where.count):
            for offset, share in zip(where.corner_offsets(level), shares):
                place = builder.gep(target, [offset])
                builder.store(builder.fadd(builder.load(place), lane(builder, share, level)), place)
        return context.get_dummy_value()

    return types.void(buffer, INDEX, layout, SCALAR, SCALAR, SCALAR, SCALAR, levels), generate


@intrinsic
def hash_sum_slopes(typing, table, layout, x, y, z, gradient, out, at, levels):
    """out[at:at+3] += gradient * d(hash_sum)/d(x, y, z)."""

    def generate(context, builder, sig, args):
        where = _placed(context, builder, sig.args[1], args[1], args[2:5], sig.args[-1].count)
        corners = _corners(where, data_pointer(context, builder, sig.args[0], args[0]))
        target = builder.gep(data_pointer(context, builder, sig.args[6], args[6]), [args[7]])
        for axis, step in enumerate(steps(where.lanes, corners, where.fractions)):
            slope = where.lanes.total(where.lanes.mul(where.resolutions, step))
            place = builder.gep(target, [ir.Constant(INT32, axis)])
            builder.store(builder.fadd(builder.load(place), builder.fmul(args[5], slope)), place)
        return context.get_dummy_value()

    return types.void(table, layout, SCALAR, SCALAR, SCALAR, SCALAR, out, INDEX, levels), generate
