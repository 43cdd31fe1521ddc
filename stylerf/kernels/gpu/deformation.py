"""Gradients of a deformation x' = x + D(x), and where a deformed field is occupied; see kernels/cpu/deformation.py.

Densities and colors add to the gradient of each sample's position, one after another; from there it is scattered to the
vertices of the grid D by atomics. D is flat [cells^3, 3] on the vertices of the cube, interpolated trilinearly, as in
ray marching.
"""

import triton
import triton.language as tl

from stylerf.kernels.gpu.color_heads import head_rows
from stylerf.kernels.gpu.hash_color import lane_gradients, vertex_row
from stylerf.kernels.gpu.hash_levels import level_tile_slopes
from stylerf.kernels.gpu.indexing import SIZES, cell, offset, store_vector, trilinear_corner, vector
from stylerf.kernels.gpu.march import cell_number, displaced, warp_at
from stylerf.kernels.gpu.shading import bands_of, of_channel, to_learn
from stylerf.kernels.gpu.tables import VM
from stylerf.kernels.gpu.vm import place, tile


@triton.jit
def slopes(table, first, second, line, fu, fv, fw, columns, RANK: tl.constexpr, mask):
    """Tiles [samples, WIDTH] of d(plane * along) / d(fu, fv, fw), per cell width."""
    p00, p01 = tile(table, first, columns, RANK, mask), tile(table, first + 1, columns, RANK, mask)
    p10, p11 = tile(table, second, columns, RANK, mask), tile(table, second + 1, columns, RANK, mask)
    low, high = tile(table, line, columns, RANK, mask), tile(table, line + 1, columns, RANK, mask)
    plane = (1.0 - fu) * ((1.0 - fv) * p00 + fv * p01) + fu * ((1.0 - fv) * p10 + fv * p11)
    along = (1.0 - fw) * low + fw * high
    of_u = ((1.0 - fv) * (p10 - p00) + fv * (p11 - p01)) * along
    of_v = ((1.0 - fu) * (p01 - p00) + fu * (p11 - p10)) * along
    return of_u, of_v, plane * (high - low)


@triton.jit
def turned(m: tl.constexpr, u, v, w, s0, s1, s2):
    """Slopes along plane m's axes, per cell of its table, converted to slopes along x, y, z of the cube."""
    if m == 0:
        x, y, z = w, u, v
    elif m == 1:
        x, y, z = v, w, u
    else:
        x, y, z = u, v, w
    return x * (s0 - 1), y * (s1 - 1), z * (s2 - 1)


@triton.jit(do_not_specialize=SIZES)
def density_position_kernel(
    table, layout, points, sigma, sigma_gradients, total, out, s0, s1, s2,
    DENSITY: tl.constexpr, RANK: tl.constexpr, WIDTH: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Add dL/dx of a vm or hash density to out [n, 3]; the slope is that of the cell that contains the sample."""
    count = tl.load(total)
    columns = tl.arange(0, WIDTH)
    for block in range(tl.program_id(0).to(tl.int64), tl.cdiv(count, BLOCK), tl.num_programs(0)):
        k = block * BLOCK + tl.arange(0, BLOCK)
        inside = k < count
        g = tl.load(sigma_gradients + k, mask=inside, other=0.0) * tl.load(sigma + k, mask=inside, other=0.0)
        valid = inside & (g != 0.0)
        x, y, z = vector(points, k, valid)
        ax, ay, az = vector(out, k, valid)
        mask = valid[:, None] & (columns[None, :] < RANK)
        if DENSITY == VM:
            for m in tl.static_range(3):
                first, second, line, fu, fv, fw = place(m, x, y, z, s0, s1, s2)
                u, v, w = slopes(table, first, second, line, fu, fv, fw, columns, RANK, mask)
                u, v, w = tl.sum(u, axis=1), tl.sum(v, axis=1), tl.sum(w, axis=1)
                bx, by, bz = turned(m, u, v, w, s0, s1, s2)
                ax, ay, az = ax + g * bx, ay + g * by, az + g * bz
        else:
            u, v, w = level_tile_slopes(table, layout, x, y, z, columns, RANK, 1, mask)
            ax, ay, az = ax + g * tl.sum(u, axis=1), ay + g * tl.sum(v, axis=1), az + g * tl.sum(w, axis=1)
        # A sample belongs to one lane, and launches follow one another: no atomics needed.
        store_vector(out, k, ax, ay, az, valid)


@triton.jit(do_not_specialize=SIZES, do_not_specialize_on_alignment=["head"])
def vm_color_position_kernel(
    table, head, points, directions, ray_of, colors, color_gradients, total, out, s0, s1, s2,
    RANK: tl.constexpr, WIDTH: tl.constexpr, BANDS: tl.constexpr, OUTPUTS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Add dL/dx of vm colors to out [n, 3]; samples with colors[k, 0] < 0 are skipped."""
    count = tl.load(total)
    columns, output = tl.arange(0, WIDTH), tl.arange(0, OUTPUTS)
    for block in range(tl.program_id(0).to(tl.int64), tl.cdiv(count, BLOCK), tl.num_programs(0)):
        k = block * BLOCK + tl.arange(0, BLOCK)
        valid, g0, g1, g2 = to_learn(k, k < count, colors, color_gradients)
        x, y, z = vector(points, k, valid)
        ax, ay, az = vector(out, k, valid)
        dx, dy, dz = vector(directions, tl.load(ray_of + k, mask=valid, other=0), valid)
        own = of_channel(output, g0, g1, g2, BANDS) * bands_of(dx, dy, dz, output, BANDS)
        mask = valid[:, None] & (columns[None, :] < RANK)
        for m in tl.static_range(3):
            first, second, line, fu, fv, fw = place(m, x, y, z, s0, s1, s2)
            u, v, w = slopes(table, first, second, line, fu, fv, fw, columns, RANK, mask)
            rows = head_rows(head, m, columns, output, RANK, 3 * RANK, 3 * BANDS)
            g = tl.dot(own, rows, input_precision="ieee")
            u, v, w = tl.sum(g * u, axis=1), tl.sum(g * v, axis=1), tl.sum(g * w, axis=1)
            bx, by, bz = turned(m, u, v, w, s0, s1, s2)
            ax, ay, az = ax + bx, ay + by, az + bz
        store_vector(out, k, ax, ay, az, valid)


@triton.jit
def level_slopes(table, layout, level: tl.constexpr, LEVELS: tl.constexpr, x, y, z, gradient, mask):
    """Slopes [samples] along x, y, z of the cube of gradient [samples, 4] times one level's interpolated values."""
    cells = tl.load(layout + level)
    i, fx = cell(x, cells + 1)
    j, fy = cell(y, cells + 1)
    k, fz = cell(z, cells + 1)
    lane = tl.arange(0, 4)
    of_x, of_y, of_z = x * 0.0, x * 0.0, x * 0.0
    for corner in tl.static_range(8):
        row = vertex_row(layout, level, LEVELS, i + corner // 4, j + (corner // 2) % 2, k + corner % 2)
        values = tl.load(table + row[:, None] + lane[None, :], mask=mask[:, None], other=0.0).to(tl.float32)
        # A corner's weight wx wy wz has the slope +-wy wz along x, and so on.
        along = tl.sum(values * gradient, axis=1)
        wx = fx if corner // 4 == 1 else 1.0 - fx
        wy = fy if (corner // 2) % 2 == 1 else 1.0 - fy
        wz = fz if corner % 2 == 1 else 1.0 - fz
        of_x += along * wy * wz if corner // 4 == 1 else -along * wy * wz
        of_y += along * wx * wz if (corner // 2) % 2 == 1 else -along * wx * wz
        of_z += along * wx * wy if corner % 2 == 1 else -along * wx * wy
    return of_x * cells, of_y * cells, of_z * cells


@triton.jit
def hash_color_position_kernel(
    table, layout, points, colors, color_gradients, total, out, LEVELS: tl.constexpr, BLOCK: tl.constexpr
):
    """Add dL/dx of a hash grid's colors to out [n, 3]; samples with colors[k, 0] < 0 are skipped."""
    count = tl.load(total)
    lane = tl.arange(0, 4)
    for block in range(tl.program_id(0).to(tl.int64), tl.cdiv(count, BLOCK), tl.num_programs(0)):
        k = block * BLOCK + tl.arange(0, BLOCK)
        valid, g0, g1, g2 = to_learn(k, k < count, colors, color_gradients)
        g = lane_gradients(lane, g0, g1, g2)
        x, y, z = vector(points, k, valid)
        ax, ay, az = vector(out, k, valid)
        for level in tl.static_range(LEVELS):
            bx, by, bz = level_slopes(table, layout, level, LEVELS, x, y, z, g, valid)
            ax, ay, az = ax + bx, ay + by, az + bz
        store_vector(out, k, ax, ay, az, valid)


@triton.jit(do_not_specialize=["cells"])
def displacement_backward_kernel(
    space, origins, directions, ray_of, t, deltas, points, position_gradients, total, to, cells,
    KIND: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Add dL/dD to `to`, flat [cells^3, 3], from dL/dx' [n, 3]; points: the displaced positions x'.

    Coordinates clamped to the cube get no gradient. Samples with delta 0 are the opaque background, which is not
    displaced.
    """
    count = tl.load(total)
    for block in range(tl.program_id(0).to(tl.int64), tl.cdiv(count, BLOCK), tl.num_programs(0)):
        k = block * BLOCK + tl.arange(0, BLOCK)
        inside = k < count
        valid = inside & (tl.load(deltas + k, mask=inside, other=0.0) != 0.0)
        ray = tl.load(ray_of + k, mask=valid, other=0)
        far = tl.load(t + k, mask=valid, other=0.0)
        ox, oy, oz = vector(origins, ray, valid)
        dx, dy, dz = vector(directions, ray, valid)
        x, y, z, _speed, _jacobian = warp_at(KIND, space, ox + far * dx, oy + far * dy, oz + far * dz, dx, dy, dz)
        mx, my, mz = vector(points, k, valid)
        gx, gy, gz = vector(position_gradients, k, valid)
        moves_x, moves_y, moves_z = (mx > 0.0) & (mx < 1.0), (my > 0.0) & (my < 1.0), (mz > 0.0) & (mz < 1.0)
        i, fx = cell(x, cells)
        j, fy = cell(y, cells)
        h, fz = cell(z, cells)
        at = (i.to(tl.int64) * cells + j) * cells + h
        for corner in tl.static_range(8):
            share = trilinear_corner(corner, fx, fy, fz)
            there = to + offset(at + ((corner // 4) * cells + (corner // 2) % 2) * cells + corner % 2, 3, 0)
            tl.atomic_add(there, share * gx, mask=valid & moves_x, sem="relaxed")
            tl.atomic_add(there + 1, share * gy, mask=valid & moves_y, sem="relaxed")
            tl.atomic_add(there + 2, share * gz, mask=valid & moves_z, sem="relaxed")


@triton.jit(do_not_specialize=["cells", "reach", "grid_cells"])
def displaced_cells_kernel(distances, cells, reach, grid, grid_cells, occupied, BLOCK: tl.constexpr):
    """Set occupied[cell] to 1 where D maps any of 27 points in the cell into an occupied one, else to 0.

    distances: as in Occupancy, flat [cells^3]. Cells farther than `reach` from an occupied one are skipped. One lane
    per point.
    """
    n = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    point = tl.arange(0, 32)[None, :]
    valid = n < cells.to(tl.int64) * cells * cells
    near = valid & (tl.load(distances + n, mask=valid, other=255).to(tl.int32) <= reach)
    found = n.to(tl.int32) * 0
    if tl.max(near.to(tl.int32), axis=0) > 0:
        i, j, k = (n // cells // cells)[:, None], (n // cells % cells)[:, None], (n % cells)[:, None]
        # A lattice of 3^3 points, 2 % inside the cell, so that rounding leaves them there.
        looks = near[:, None] & (point < 27)
        x = (i.to(tl.float32) + (0.02 + 0.48 * (point // 9))) / cells
        y = (j.to(tl.float32) + (0.02 + 0.48 * (point // 3 % 3))) / cells
        z = (k.to(tl.float32) + (0.02 + 0.48 * (point % 3))) / cells
        x, y, z = displaced(grid, grid_cells, x, y, z, looks)
        there = tl.load(distances + cell_number(x, y, z, cells), mask=looks, other=1).to(tl.int32)
        found = tl.max((looks & (there == 0)).to(tl.int32), axis=1)
    tl.store(occupied + n, found.to(tl.uint8), mask=valid)
