"""Sparse voxel grids (kernels/cpu/voxel.py).

links: int32, from Grid in fields/voxel.py: six numbers that describe the grid, then each block's index in the table.
s0, s1, s2: vertices per axis.
"""

import triton
import triton.language as tl

from stylerf.kernels.gpu.indexing import SIZES, cell, offset, trilinear_corner


@triton.jit
def row_of(links, s1, s2, i, j, k, mask):
    """Row (int64) of the vertex i, j, k (int32) in the table; 0..63: in the block shared by all unallocated ones."""
    block = ((i >> 2).to(tl.int64) * ((s1 + 3) // 4) + (j >> 2)) * ((s2 + 3) // 4) + (k >> 2)
    number = tl.load(links + 6 + block, mask=mask, other=0).to(tl.int64)
    return number * 64 + (i & 3) * 16 + (j & 3) * 4 + (k & 3)


@triton.jit
def corners(links, x, y, z, s0, s1, s2, valid):
    """(rows, weights) [samples, 8] of the vertices around points, x slowest."""
    corner = tl.arange(0, 8)[None, :]
    i, fx = cell(x, s0)
    j, fy = cell(y, s1)
    k, fz = cell(z, s2)
    di, dj, dk = corner // 4, (corner // 2) % 2, corner % 2
    rows = row_of(links, s1, s2, i[:, None] + di, j[:, None] + dj, k[:, None] + dk, valid[:, None])
    along_x = tl.where(di == 1, fx[:, None], 1.0 - fx[:, None])
    along_y = tl.where(dj == 1, fy[:, None], 1.0 - fy[:, None])
    along_z = tl.where(dk == 1, fz[:, None], 1.0 - fz[:, None])
    return rows, along_x * along_y * along_z


@triton.jit
def row_tile(table, links, x, y, z, s0, s1, s2, columns, ROW: tl.constexpr, valid, mask):
    """[samples, WIDTH]: interpolated rows of ROW floats, from a float32 or float16 table. mask: valid by columns."""
    i, fx = cell(x, s0)
    j, fy = cell(y, s1)
    k, fz = cell(z, s2)
    total = x[:, None] * 0.0 + columns[None, :] * 0.0
    for corner in tl.static_range(8):
        row = row_of(links, s1, s2, i + corner // 4, j + (corner // 2) % 2, k + corner % 2, valid)
        values = tl.load(table + offset(row[:, None], ROW, columns[None, :]), mask=mask, other=0.0).to(tl.float32)
        total += trilinear_corner(corner, fx, fy, fz)[:, None] * values
    return total


@triton.jit
def row_tile_scatter(to, links, x, y, z, s0, s1, s2, gradient, columns, ROW: tl.constexpr, valid, mask):
    """Add gradient [samples, WIDTH] times each allocated vertex's weight to the rows of `to`, laid out as the table."""
    i, fx = cell(x, s0)
    j, fy = cell(y, s1)
    k, fz = cell(z, s2)
    for corner in tl.static_range(8):
        row = row_of(links, s1, s2, i + corner // 4, j + (corner // 2) % 2, k + corner % 2, valid)
        share = trilinear_corner(corner, fx, fy, fz)[:, None] * gradient
        # Block 0 stands for all empty space: it never learns, and nothing would clear its gradients.
        kept = mask & (row >= 64)[:, None]
        tl.atomic_add(to + offset(row[:, None], ROW, columns[None, :]), share, mask=kept, sem="relaxed")


@triton.jit(do_not_specialize=[*SIZES, "rows"])
def smoothness_kernel(
    table, links, places, to, strength, rows, s0, s1, s2, ROW: tl.constexpr, WIDTH: tl.constexpr, BLOCK: tl.constexpr
):
    """Add strength * d/dt of half the sum of squared differences of neighboring allocated vertices to `to`.

    rows: of the table; places: int32 [blocks of the table, 3], each block's position in the grid of blocks.
    """
    row = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    columns = tl.arange(0, WIDTH)
    listed = (row >= 64) & (row < rows)
    block = offset(row // 64, 3, 0)
    i = tl.load(places + block, mask=listed, other=0) * 4 + ((row // 16) % 4).to(tl.int32)
    j = tl.load(places + block + 1, mask=listed, other=0) * 4 + ((row // 4) % 4).to(tl.int32)
    k = tl.load(places + block + 2, mask=listed, other=0) * 4 + (row % 4).to(tl.int32)
    # The last blocks reach beyond the grid.
    valid = listed & (i < s0) & (j < s1) & (k < s2)
    own = valid[:, None] & (columns[None, :] < ROW)
    at = offset(row[:, None], ROW, columns[None, :])
    here = tl.load(table + at, mask=own, other=0.0)
    total = here * 0.0
    for side in tl.static_range(6):
        way = 2 * (side % 2) - 1
        u = i + (way if side // 2 == 0 else 0)
        v = j + (way if side // 2 == 1 else 0)
        w = k + (way if side // 2 == 2 else 0)
        within = valid & (u >= 0) & (v >= 0) & (w >= 0) & (u < s0) & (v < s1) & (w < s2)
        there = row_of(links, s1, s2, u, v, w, within)
        both = own & (within & (there >= 64))[:, None]
        beside = tl.load(table + offset(there[:, None], ROW, columns[None, :]), mask=both, other=0.0)
        total += tl.where(both, here - beside, 0.0)
    tl.store(to + at, tl.load(to + at, mask=own, other=0.0) + strength * total, mask=own)
