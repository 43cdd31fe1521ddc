"""encode, hash: kernels/cpu/hash_density.py, a multi-resolution hash grid as a density, a column to a level.

WIDTH: the number of levels rounded up to a power of two.
"""

import triton
import triton.language as tl

from stylerf.kernels.gpu.hash_levels import level_tile, level_tile_scatter
from stylerf.kernels.gpu.indexing import vector
from stylerf.kernels.gpu.vm import EXPONENT_MAX, EXPONENT_MIN


@triton.jit
def raw_density(table, layout, shift, x, y, z, valid, LEVELS: tl.constexpr, WIDTH: tl.constexpr):
    """exp(shift + levels) of points; shift: pointer."""
    columns = tl.arange(0, WIDTH)
    mask = valid[:, None] & (columns[None, :] < LEVELS)
    total = tl.load(shift) + tl.sum(level_tile(table, layout, x, y, z, columns, LEVELS, 1, mask), axis=1)
    return tl.exp(tl.minimum(tl.maximum(total, EXPONENT_MIN), EXPONENT_MAX))


@triton.jit(do_not_specialize_on_alignment=["shift_to"])
def density_backward_kernel(
    layout, points, sigma, sigma_gradients, total, to, shift_to,
    LEVELS: tl.constexpr, WIDTH: tl.constexpr, BLOCK: tl.constexpr,
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
        mask = valid[:, None] & (columns[None, :] < LEVELS)
        tl.atomic_add(shift_to, tl.sum(tl.where(valid, g, 0.0), axis=0), sem="relaxed")
        level_tile_scatter(to, layout, x, y, z, tl.where(mask, g[:, None], 0.0), columns, LEVELS, 1, mask)


@triton.jit(do_not_specialize=["vertices", "first"])
def smoothness_kernel(table, to, strength, vertices, first, ROW: tl.constexpr, BLOCK: tl.constexpr):
    """Add strength * d/dt of half the summed squared differences of neighboring vertices of one direct level to `to`.

    vertices: a side; first: the level's first float; a lane to a float.
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
