"""Gather and scatter of a voxel grid's rows, in LLVM IR: the eight vertices around a point, given by their offsets."""

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from stylerf.kernels.cpu.simd_hash import interpolate, steps
from stylerf.kernels.cpu.simd_vm import INDEX, INT32, SCALAR, Rows, data_pointer


def _rows_at(rows, table, offsets):
    """Return the rows of the eight vertices; offsets: pointer to eight int64, x slowest, z fastest."""
    builder = rows.builder
    places = [builder.load(builder.gep(offsets, [ir.Constant(INT32, corner)])) for corner in range(8)]
    return places, [rows.load(table, place) for place in places]


@intrinsic
def voxel_row(typing, table, offsets, fx, fy, fz, out, at, widths):
    """out[at : at + width] = the eight rows of `table` at offsets [8] int64, interpolated; f: position in the cell."""

    def generate(context, builder, sig, args):
        rows = Rows(builder, sig.args[-1].count)
        table_at, offsets_at, out_at = (data_pointer(context, builder, sig.args[i], args[i]) for i in (0, 1, 5))
        _, values = _rows_at(rows, table_at, offsets_at)
        rows.store(out_at, args[6], interpolate(rows, values, [rows.splat(f) for f in args[2:5]]))
        return context.get_dummy_value()

    return types.void(table, offsets, SCALAR, SCALAR, SCALAR, out, INDEX, widths), generate


@intrinsic
def voxel_row_backward(typing, buffer, base, offsets, fx, fy, fz, gradients, at, widths):
    """Add each vertex's share of gradients[at : at + width] to buffer[base + offsets]."""

    def generate(context, builder, sig, args):
        rows = Rows(builder, sig.args[-1].count)
        target = builder.gep(data_pointer(context, builder, sig.args[0], args[0]), [args[1]])
        offsets_at, gradients_at = (data_pointer(context, builder, sig.args[i], args[i]) for i in (2, 6))
        shares = [rows.load(gradients_at, args[7])]
        for fraction in args[3:6]:
            high = [rows.mul(rows.splat(fraction), share) for share in shares]
            shares = [s for share, h in zip(shares, high) for s in (rows.sub(share, h), h)]
        for corner, share in enumerate(shares):
            rows.add_to(target, builder.load(builder.gep(offsets_at, [ir.Constant(INT32, corner)])), share)
        return context.get_dummy_value()

    return types.void(buffer, INDEX, offsets, SCALAR, SCALAR, SCALAR, gradients, INDEX, widths), generate


@intrinsic
def voxel_row_slopes(typing, table, offsets, fx, fy, fz, gradients, at, out, widths):
    """out[0:3] = d(gradients . interpolated row)/d(fx, fy, fz)."""

    def generate(context, builder, sig, args):
        rows = Rows(builder, sig.args[-1].count)
        pointers = [data_pointer(context, builder, sig.args[i], args[i]) for i in (0, 1, 5, 7)]
        _, values = _rows_at(rows, pointers[0], pointers[1])
        gradient = rows.load(pointers[2], args[6])
        for axis, step in enumerate(steps(rows, values, [rows.splat(f) for f in args[2:5]])):
            slope = rows.total(rows.mul(gradient, step))
            builder.store(slope, builder.gep(pointers[3], [ir.Constant(INT32, axis)]))
        return context.get_dummy_value()

    return types.void(table, offsets, SCALAR, SCALAR, SCALAR, gradients, INDEX, out, widths), generate
