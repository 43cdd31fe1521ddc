"""The hash color of kernels/cpu/hash_grid.py, with one lane per sample and four lanes per vertex, forward and backward.

layout: int32 [6, LEVELS] from Levels.layout() in fields/hash_grid.py: cells per side, multipliers of x and y, mask,
first float, -1 where hashed. Products of hashed levels wrap in 32 bits, as on the CPU.
"""

import triton
import triton.language as tl

from stylerf.kernels.gpu.hash_levels import vertex_number
from stylerf.kernels.gpu.indexing import cell, offset, store_vector, trilinear_corner, vector
from stylerf.kernels.gpu.shading import sigmoid, to_color, to_learn


@triton.jit
def vertex_row(layout, level: tl.constexpr, LEVELS: tl.constexpr, i, j, k):
    """First float (int64) of a level's vertex i, j, k (int32)."""
    times_x, times_y = tl.load(layout + LEVELS + level), tl.load(layout + 2 * LEVELS + level)
    mask, first = tl.load(layout + 3 * LEVELS + level), tl.load(layout + 4 * LEVELS + level)
    hashed = tl.load(layout + 5 * LEVELS + level)
    return vertex_number(times_x, times_y, mask, hashed, i, j, k) * 4 + first


@triton.jit
def level_sum(table, layout, level: tl.constexpr, LEVELS: tl.constexpr, x, y, z, mask):
    """[samples, 4]: one level, interpolated."""
    size = tl.load(layout + level) + 1
    i, fx = cell(x, size)
    j, fy = cell(y, size)
    k, fz = cell(z, size)
    lane = tl.arange(0, 4)
    total = x[:, None] * 0.0 + lane[None, :] * 0.0
    for corner in tl.static_range(8):
        row = vertex_row(layout, level, LEVELS, i + corner // 4, j + (corner // 2) % 2, k + corner % 2)
        values = tl.load(table + row[:, None] + lane[None, :], mask=mask[:, None], other=0.0).to(tl.float32)
        total += trilinear_corner(corner, fx, fy, fz)[:, None] * values
    return total


@triton.jit
def level_scatter(to, layout, level: tl.constexpr, LEVELS: tl.constexpr, x, y, z, gradient, mask):
    """Add gradient [samples, 4] times each vertex's weight to the level's rows of `to`, laid out as the table."""
    size = tl.load(layout + level) + 1
    i, fx = cell(x, size)
    j, fy = cell(y, size)
    k, fz = cell(z, size)
    lane = tl.arange(0, 4)
    for corner in tl.static_range(8):
        row = vertex_row(layout, level, LEVELS, i + corner // 4, j + (corner // 2) % 2, k + corner % 2)
        # Atomics: other samples share the vertex, in a hashed level even distant ones.
        part = trilinear_corner(corner, fx, fy, fz)[:, None] * gradient
        tl.atomic_add(to + row[:, None] + lane[None, :], part, mask=mask[:, None], sem="relaxed")


@triton.jit
def logit(values, lane, j: tl.constexpr):
    """f[j] + f[3] for values [samples, 4]."""
    own = (lane == j) | (lane == 3)
    return tl.sum(tl.where(own[None, :], values, 0.0), axis=1)


@triton.jit
def lane_gradients(lane, g0, g1, g2):
    """dL/df [samples, 4] from dL/d(logits); the fourth float is part of every channel's logit."""
    three = tl.where(lane[None, :] == 2, g2[:, None], (g0 + g1 + g2)[:, None])
    return tl.where(lane[None, :] == 0, g0[:, None], tl.where(lane[None, :] == 1, g1[:, None], three))


@triton.jit
def color_kernel(
    table, layout, points, ray_of, weights, largest, weight_threshold, total, out,
    LEVELS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """out [n, 3]: sigmoid(f[0:3] + f[3]); -1 for samples below weight_threshold times their ray's largest weight."""
    count = tl.load(total)
    lane = tl.arange(0, 4)
    for block in range(tl.program_id(0).to(tl.int64), tl.cdiv(count, BLOCK), tl.num_programs(0)):
        k = block * BLOCK + tl.arange(0, BLOCK)
        inside, valid, _ray = to_color(k, count, ray_of, weights, largest, weight_threshold)
        if tl.max(valid.to(tl.int32), axis=0) > 0:
            x, y, z = vector(points, k, valid)
            f = x[:, None] * 0.0 + lane[None, :] * 0.0
            for level in tl.static_range(LEVELS):
                f += level_sum(table, layout, level, LEVELS, x, y, z, valid)
            red, green, blue = sigmoid(logit(f, lane, 0)), sigmoid(logit(f, lane, 1)), sigmoid(logit(f, lane, 2))
            store_vector(out, k, red, green, blue, valid)
        tl.store(out + offset(k, 3, 0), -1.0, mask=inside & (valid == 0))


@triton.jit
def color_backward_kernel(
    layout, points, colors, color_gradients, total, to, LEVELS: tl.constexpr, BLOCK: tl.constexpr
):
    """Add dL/d(table); samples with colors[k, 0] < 0 are skipped."""
    count = tl.load(total)
    lane = tl.arange(0, 4)
    for block in range(tl.program_id(0).to(tl.int64), tl.cdiv(count, BLOCK), tl.num_programs(0)):
        k = block * BLOCK + tl.arange(0, BLOCK)
        valid, g0, g1, g2 = to_learn(k, k < count, colors, color_gradients)
        g = lane_gradients(lane, g0, g1, g2)
        x, y, z = vector(points, k, valid)
        for level in tl.static_range(LEVELS):
            level_scatter(to, layout, level, LEVELS, x, y, z, g, valid)


@triton.jit(do_not_specialize=["count"])
def rows_kernel(table, layout, points, out, count, LEVELS: tl.constexpr, BLOCK: tl.constexpr):
    """out [count, 4 LEVELS]: the levels' interpolated values, concatenated (kernels/cpu/hash_grid.py)."""
    k = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    valid = k < count
    lane = tl.arange(0, 4)
    x, y, z = vector(points, k, valid)
    for level in tl.static_range(LEVELS):
        f = level_sum(table, layout, level, LEVELS, x, y, z, valid)
        at = offset(k[:, None], 4 * LEVELS, 4 * level + lane[None, :])
        tl.store(out + at, f, mask=valid[:, None])


@triton.jit(do_not_specialize=["count"])
def rows_backward_kernel(layout, points, gradients, to, count, LEVELS: tl.constexpr, BLOCK: tl.constexpr):
    """Add dL/d(table), from gradients [count, 4 LEVELS] of rows_kernel's out."""
    k = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    valid = k < count
    lane = tl.arange(0, 4)
    x, y, z = vector(points, k, valid)
    for level in tl.static_range(LEVELS):
        at = offset(k[:, None], 4 * LEVELS, 4 * level + lane[None, :])
        g = tl.load(gradients + at, mask=valid[:, None], other=0.0)
        level_scatter(to, layout, level, LEVELS, x, y, z, g, valid)
