"""The gather and scatter of a hash grid whose vertices carry one float each, in LLVM IR.

With so short a row there is nothing to load as one vector; instead every vector holds one corner of all levels, a level
to a lane, and the eight corners are mixed in seven operations whatever the number of levels.
"""

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from stylerf.kernels.cpu.simd_hash import Levels, interpolate, lane, steps
from stylerf.kernels.cpu.simd_vm import INDEX, INT32, SCALAR, data_pointer


def _placed(context, builder, sig, layout, point, count):
    return Levels(context, builder, data_pointer(context, builder, sig, layout), point, count, row=1)


def _corners(where, table) -> list:
    """Values at the eight corners, each a vector over levels."""
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
