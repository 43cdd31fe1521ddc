"""Encoders of places as tiles of features, of any kind: what the color heads read (fields/encoders.py), and back.

A place's features are PIECES tiles of RANK columns: three of vm, one for each plane, and one of a hash or voxel grid.
layout: the levels' (hash), links (voxel), not read (vm). s0, s1, s2: vertices per axis of vm's and voxels' grids.
"""

import triton
import triton.language as tl

from stylerf.kernels.gpu.density import HASH, VM
from stylerf.kernels.gpu.hash_levels import level_tile, level_tile_scatter
from stylerf.kernels.gpu.indexing import offset, vector
from stylerf.kernels.gpu.vm import place, product, scatter
from stylerf.kernels.gpu.voxel import row_tile, row_tile_scatter

ROW = tl.constexpr(4)  # floats at a hash grid's vertex


@triton.jit
def piece(
    m: tl.constexpr, table, layout, x, y, z, s0, s1, s2, columns, valid, ENCODER: tl.constexpr, RANK: tl.constexpr
):
    """[samples, WIDTH]: piece m of the features of points; zero beyond RANK columns and where not valid."""
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


@triton.jit
def to_color(k, count, ray_of, weights, largest, weight_threshold):
    """(inside, valid, ray): which samples exist, which reach the threshold on their weight, their rays."""
    inside = k < count
    ray = tl.load(ray_of + k, mask=inside, other=0)
    w = tl.load(weights + k, mask=inside, other=0.0)
    return inside, inside & (w > 0.0) & (w >= weight_threshold * tl.load(largest + ray, mask=inside, other=0.0)), ray


@triton.jit
def to_learn(k, count, ray_of, colors, color_gradients):
    """(valid, ray, g0, g1, g2): which samples have a color, their rays, dL/d(logits), zero where there is none."""
    valid = tl.load(colors + offset(k, 3, 0), mask=k < count, other=-1.0) >= 0.0
    ray = tl.load(ray_of + k, mask=valid, other=0)
    c0, c1, c2 = vector(colors, k, valid)
    g0, g1, g2 = vector(color_gradients, k, valid)
    return valid, ray, g0 * c0 * (1.0 - c0), g1 * c1 * (1.0 - c1), g2 * c2 * (1.0 - c2)
