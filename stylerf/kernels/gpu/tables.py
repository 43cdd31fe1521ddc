"""Densities and features of any kind from one flat table, forward and backward; the kind is a compile-time constant.

layout, RANK: unused and the rank (vm); the levels' layout and the total floats per point (hash); links and floats per
vertex (voxel). s0, s1, s2: vertices per axis of vm and voxel grids. WIDTH: columns of a tile, a power of two.

A point's features are PIECES tiles of RANK columns: three for vm, one per plane, and one for a hash or voxel grid.
Kernels process the packed samples in a grid-stride loop, BLOCK at a time, so their number need not be known at launch.
"""

import triton
import triton.language as tl

from stylerf.kernels.cpu import march, simd_hash
from stylerf.kernels.gpu.hash_levels import level_tile, level_tile_scatter
from stylerf.kernels.gpu.indexing import SIZES, vector
from stylerf.kernels.gpu.vm import place, product, scatter
from stylerf.kernels.gpu.voxel import corners, row_tile, row_tile_scatter

VM, HASH, VOXEL = tl.constexpr(0), tl.constexpr(1), tl.constexpr(2)
EXPONENT_MIN, EXPONENT_MAX = tl.constexpr(float(march.EXPONENT_MIN)), tl.constexpr(float(march.EXPONENT_MAX))
ROW = tl.constexpr(simd_hash.ROW)  # floats at a hash grid's vertex, as features


@triton.jit
def raw_density(
    table, layout, shift, x, y, z, s0, s1, s2, valid,
    DENSITY: tl.constexpr, RANK: tl.constexpr, WIDTH: tl.constexpr,
):  # fmt: skip
    """exp(shift + features) at points; shift: pointer. The table may be in half precision."""
    columns = tl.arange(0, WIDTH)
    mask = valid[:, None] & (columns[None, :] < RANK)
    # x * 0.0, here and in other kernels: zeros of the shape of x.
    total = x * 0.0 + tl.load(shift)
    if DENSITY == VM:
        for m in tl.static_range(3):
            first, second, line, fu, fv, fw = place(m, x, y, z, s0, s1, s2)
            plane, along = product(table, first, second, line, fu, fv, fw, columns, RANK, mask)
            total += tl.sum(plane * along, axis=1)
    elif DENSITY == HASH:
        total += tl.sum(level_tile(table, layout, x, y, z, columns, RANK, 1, mask), axis=1)
    else:
        rows, weights = corners(layout, x, y, z, s0, s1, s2, valid)
        values = tl.load(table + rows, mask=valid[:, None], other=0.0).to(tl.float32)
        total += tl.sum(weights * values, axis=1)
    return tl.exp(tl.minimum(tl.maximum(total, EXPONENT_MIN), EXPONENT_MAX))


@triton.jit(do_not_specialize=[*SIZES, "count"], do_not_specialize_on_alignment=["shift"])
def density_kernel(
    table, layout, shift, points, sigma, count, s0, s1, s2,
    DENSITY: tl.constexpr, RANK: tl.constexpr, WIDTH: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """sigma[k] at points [count, 3]."""
    k = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    valid = k < count
    x, y, z = vector(points, k, valid)
    s = raw_density(table, layout, shift, x, y, z, s0, s1, s2, valid, DENSITY, RANK, WIDTH)
    tl.store(sigma + k, s, mask=valid)


@triton.jit(do_not_specialize=SIZES, do_not_specialize_on_alignment=["shift_to"])
def density_backward_kernel(
    table, layout, points, sigma, sigma_gradients, total, to, shift_to, s0, s1, s2,
    DENSITY: tl.constexpr, RANK: tl.constexpr, WIDTH: tl.constexpr, BLOCK: tl.constexpr,
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
        # All samples share the shift: one atomic for a block, not one for each (decision 0019).
        tl.atomic_add(shift_to, tl.sum(tl.where(valid, g, 0.0), axis=0), sem="relaxed")
        if DENSITY == VM:
            for m in tl.static_range(3):
                first, second, line, fu, fv, fw = place(m, x, y, z, s0, s1, s2)
                plane, along = product(table, first, second, line, fu, fv, fw, columns, RANK, mask)
                scatter(to, first, second, line, fu, fv, fw, plane, along, g[:, None], columns, RANK, mask)
        elif DENSITY == HASH:
            level_tile_scatter(to, layout, x, y, z, tl.where(mask, g[:, None], 0.0), columns, RANK, 1, mask)
        else:
            rows, weights = corners(layout, x, y, z, s0, s1, s2, valid)
            # The block shared by all unallocated ones is never trained, and nothing would clear its gradients.
            tl.atomic_add(to + rows, weights * g[:, None], mask=valid[:, None] & (rows >= 64), sem="relaxed")


@triton.jit
def piece(
    m: tl.constexpr, table, layout, x, y, z, s0, s1, s2, columns, valid, ENCODER: tl.constexpr, RANK: tl.constexpr
):
    """[samples, WIDTH]: piece m of the features at points; zero beyond RANK columns and where not valid."""
    mask = valid[:, None] & (columns[None, :] < RANK)
    if ENCODER == VM:
        first, second, line, fu, fv, fw = place(m, x, y, z, s0, s1, s2)
        plane, along = product(table, first, second, line, fu, fv, fw, columns, RANK, mask)
        features = plane * along
    elif ENCODER == HASH:
        features = level_tile(table, layout, x, y, z, columns, RANK // ROW, ROW, mask)
    else:
        features = row_tile(table, layout, x, y, z, s0, s1, s2, columns, RANK, valid, mask)
    return features


@triton.jit
def piece_scatter(
    m: tl.constexpr, table, to, layout, x, y, z, s0, s1, s2, gradient, columns, valid,
    ENCODER: tl.constexpr, RANK: tl.constexpr,
):  # fmt: skip
    """Add dL/d(table) to `to`, from the gradient [samples, WIDTH] of piece m."""
    mask = valid[:, None] & (columns[None, :] < RANK)
    if ENCODER == VM:
        first, second, line, fu, fv, fw = place(m, x, y, z, s0, s1, s2)
        plane, along = product(table, first, second, line, fu, fv, fw, columns, RANK, mask)
        scatter(to, first, second, line, fu, fv, fw, plane, along, gradient, columns, RANK, mask)
    elif ENCODER == HASH:
        level_tile_scatter(to, layout, x, y, z, gradient, columns, RANK // ROW, ROW, mask)
    else:
        row_tile_scatter(to, layout, x, y, z, s0, s1, s2, gradient, columns, RANK, valid, mask)
