"""Indexing: 64-bit offsets, cells of a grid, vectors of three."""

import triton
import triton.language as tl

# A kernel compiled for every size that is a multiple of sixteen, and again for the others, gains nothing by it.
SIZES = ["s0", "s1", "s2"]


@triton.jit
def offset(row, width, column):
    """row * width + column in 64 bits: three floats per sample exceed 2^31 at 716 M samples."""
    return row.to(tl.int64) * width + column


@triton.jit
def cell(x, size):
    """Lower vertex (int32) and position in the cell (0..1) of x in 0..1 on `size` vertices; NaN maps into the grid."""
    place = x * (size - 1)
    low = tl.minimum(tl.maximum(place.to(tl.int32), 0), size - 2)
    return low, place - low.to(tl.float32)


@triton.jit
def vector(pointer, row, mask):
    """The three floats of each row of [n, 3]; zero where masked out."""
    at = offset(row, 3, 0)
    a = tl.load(pointer + at, mask=mask, other=0.0)
    b = tl.load(pointer + at + 1, mask=mask, other=0.0)
    c = tl.load(pointer + at + 2, mask=mask, other=0.0)
    return a, b, c


@triton.jit
def store_vector(pointer, row, a, b, c, mask):
    """Write three floats to each row of [n, 3]."""
    at = offset(row, 3, 0)
    tl.store(pointer + at, a, mask=mask)
    tl.store(pointer + at + 1, b, mask=mask)
    tl.store(pointer + at + 2, c, mask=mask)


@triton.jit
def trilinear_corner(corner: tl.constexpr, fx, fy, fz):
    """Weight of corner 0..7 (x slowest, z fastest) at a position in its cell."""
    wx = fx if corner // 4 == 1 else 1.0 - fx
    wy = fy if (corner // 2) % 2 == 1 else 1.0 - fy
    wz = fz if corner % 2 == 1 else 1.0 - fz
    return wx * wy * wz
