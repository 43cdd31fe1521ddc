"""A multi-resolution hash grid on tiles of samples by columns, all levels at once; see kernels/cpu/simd_hash.py.

A column is one float of one level: level column // ROW, float column % ROW, with ROW floats per vertex. A tile has
WIDTH columns, a power of two; those from ROW LEVELS on are masked out. layout: int32 [6, LEVELS], see hash_color.py.
All vertices of an inactive level (fields/hash_grid.py; hashed, with a mask of 0) map to its only row.
"""

import triton
import triton.language as tl

from stylerf.kernels.gpu.indexing import cell, trilinear_corner


@triton.jit
def vertex_number(times_x, times_y, mask, hashed, i, j, k):
    """Index (int64) within its level of the vertex i, j, k (int32)."""
    # Unsigned, because that may wrap.
    x = i.to(tl.uint32) * times_x.to(tl.uint32)
    y = j.to(tl.uint32) * times_y.to(tl.uint32)
    scrambled = (x ^ y ^ k.to(tl.uint32)) & mask.to(tl.uint32)
    direct = x + y + k.to(tl.uint32)
    return tl.where(hashed != 0, scrambled, direct).to(tl.int64)


@triton.jit
def _levels_of(layout, columns, LEVELS: tl.constexpr, ROW: tl.constexpr):
    """(vertices per side, multipliers of x and y, mask, first float of the column, hashed), [1, WIDTH] each."""
    # Columns beyond the last level repeat it: addresses stay valid, and the caller's mask leaves them out.
    level = tl.minimum(columns // ROW, LEVELS - 1)[None, :]
    first = tl.load(layout + 4 * LEVELS + level) + (columns % ROW)[None, :]
    return (
        tl.load(layout + level) + 1,
        tl.load(layout + LEVELS + level),
        tl.load(layout + 2 * LEVELS + level),
        tl.load(layout + 3 * LEVELS + level),
        first,
        tl.load(layout + 5 * LEVELS + level),
    )


@triton.jit
def level_tile(table, layout, x, y, z, columns, LEVELS: tl.constexpr, ROW: tl.constexpr, mask):
    """[samples, WIDTH]: the interpolated levels, concatenated, float32; the table may be in half precision."""
    size, times_x, times_y, of_hash, first, hashed = _levels_of(layout, columns, LEVELS, ROW)
    i, fx = cell(x[:, None], size)
    j, fy = cell(y[:, None], size)
    k, fz = cell(z[:, None], size)
    total = fx * 0.0
    for corner in tl.static_range(8):
        at = vertex_number(times_x, times_y, of_hash, hashed, i + corner // 4, j + (corner // 2) % 2, k + corner % 2)
        values = tl.load(table + at * ROW + first, mask=mask, other=0.0).to(tl.float32)
        total += trilinear_corner(corner, fx, fy, fz) * values
    return total


@triton.jit
def level_tile_slopes(table, layout, x, y, z, columns, LEVELS: tl.constexpr, ROW: tl.constexpr, mask):
    """Three tiles [samples, WIDTH]: slopes of level_tile along x, y, z of the cube, in each point's cell."""
    size, times_x, times_y, of_hash, first, hashed = _levels_of(layout, columns, LEVELS, ROW)
    i, fx = cell(x[:, None], size)
    j, fy = cell(y[:, None], size)
    k, fz = cell(z[:, None], size)
    of_x, of_y, of_z = fx * 0.0, fx * 0.0, fx * 0.0
    for corner in tl.static_range(8):
        a, b, c = corner // 4, (corner // 2) % 2, corner % 2
        at = vertex_number(times_x, times_y, of_hash, hashed, i + a, j + b, k + c)
        values = tl.load(table + at * ROW + first, mask=mask, other=0.0).to(tl.float32)
        # A corner's weight wx wy wz has the slope +-wy wz along x, and so on.
        wx, wy, wz = (fx if a else 1.0 - fx), (fy if b else 1.0 - fy), (fz if c else 1.0 - fz)
        of_x += (wy * wz * values) if a else -(wy * wz * values)
        of_y += (wx * wz * values) if b else -(wx * wz * values)
        of_z += (wx * wy * values) if c else -(wx * wy * values)
    cells = (size - 1).to(tl.float32)
    return of_x * cells, of_y * cells, of_z * cells


@triton.jit
def level_tile_scatter(to, layout, x, y, z, gradient, columns, LEVELS: tl.constexpr, ROW: tl.constexpr, mask):
    """Add gradient [samples, WIDTH] times each vertex's weight to the levels' rows of `to`, laid out as the table."""
    size, times_x, times_y, of_hash, first, hashed = _levels_of(layout, columns, LEVELS, ROW)
    waits = (hashed != 0) & (of_hash == 0)
    own = mask & (waits == 0)
    i, fx = cell(x[:, None], size)
    j, fy = cell(y[:, None], size)
    k, fz = cell(z[:, None], size)
    for corner in tl.static_range(8):
        at = vertex_number(times_x, times_y, of_hash, hashed, i + corner // 4, j + (corner // 2) % 2, k + corner % 2)
        share = trilinear_corner(corner, fx, fy, fz) * gradient
        tl.atomic_add(to + at * ROW + first, share, mask=own, sem="relaxed")
    # Every sample speaks to a waiting level's row: summed in the program first, or all atomics would meet there.
    alone = tl.sum(tl.where(mask & waits, gradient, 0.0), axis=0)[None, :]
    tl.atomic_add(to + first, alone, mask=waits & (columns[None, :] < ROW * LEVELS), sem="relaxed")


@triton.jit(do_not_specialize=["vertices", "first"])
def smoothness_kernel(table, to, strength, vertices, first, ROW: tl.constexpr, BLOCK: tl.constexpr):
    """Add strength * d/dt of half the sum of squared differences of one direct level's neighboring vertices to `to`.

    vertices: per side; first: the level's first float; one lane per float.
    """
    n = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    vertex = n // ROW
    along_y, along_z = vertices, 1
    along_x = vertices.to(tl.int64) * vertices
    valid = vertex < along_x * vertices
    i, j, k = vertex // along_x, (vertex // along_y) % vertices, vertex % vertices
    here = tl.load(table + first + n, mask=valid, other=0.0)
    total = here * 0.0
    for axis in tl.static_range(3):
        if axis == 0:
            place, apart = i, along_x
        elif axis == 1:
            place, apart = j, along_y
        else:
            place, apart = k, along_z
        below, above = valid & (place > 0), valid & (place < vertices - 1)
        lower = tl.load(table + first + n - apart * ROW, mask=below, other=0.0)
        upper = tl.load(table + first + n + apart * ROW, mask=above, other=0.0)
        total += tl.where(below, here - lower, 0.0) + tl.where(above, here - upper, 0.0)
    at = to + first + n
    tl.store(at, tl.load(at, mask=valid, other=0.0) + strength * total, mask=valid)
