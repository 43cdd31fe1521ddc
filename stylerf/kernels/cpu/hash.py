"""encode, hash: a multi-resolution hash grid (Mueller et al. 2022) as a colour that does not depend on the view.

Level l is a grid of resolutions[l]^3 cells whose vertices carry `features` floats. A level whose (resolution + 1)^3
vertices fit its table is indexed directly, others by iz ^ iy 2654435761 ^ ix 805459861 modulo the table's length, a
power of two. What the levels interpolate trilinearly, one after another, is mapped linearly to three logits.

The values are one flat float32 array: the levels' tables, then head [3, levels * features], then bias [3].
`layout` [levels, 4] int64: resolution, offset of the level's table in floats, its length - 1, 1 where directly indexed.
"""

import math

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import inline, parallel_kernel
from stylerf.kernels.cpu.vector import axpy_row, dot_rows, trilinear_row, trilinear_row_backward

_ONE, _ZERO = np.float32(1), np.float32(0)
PRIME_X, PRIME_Y = np.int64(805459861), np.int64(2654435761)


@inline
def _split(x, resolution):
    """Lower vertex and position inside the cell of x in 0..1."""
    s = x * np.float32(resolution)
    i = min(np.int64(s), resolution - 1)
    return i, s - np.float32(i)


@inline
def _corners(layout, level, i, j, k, features):
    """Offsets in the flat table of the eight vertices of cell (i, j, k), z fastest."""
    begin = layout[level, 1]
    if layout[level, 3] == 1:
        side = layout[level, 0] + 1
        o0 = begin + ((i * side + j) * side + k) * features
        o1 = o0 + features
        o2 = o0 + side * features
        o3 = o2 + features
        o4 = o0 + side * side * features
        o5 = o4 + features
        o6 = o4 + side * features
        o7 = o6 + features
        return o0, o1, o2, o3, o4, o5, o6, o7
    mask = layout[level, 2]
    x0, y0 = i * PRIME_X, j * PRIME_Y
    x1, y1 = x0 + PRIME_X, y0 + PRIME_Y
    a, b, c, d = x0 ^ y0, x0 ^ y1, x1 ^ y0, x1 ^ y1
    z = k + 1
    return (
        begin + ((a ^ k) & mask) * features,
        begin + ((a ^ z) & mask) * features,
        begin + ((b ^ k) & mask) * features,
        begin + ((b ^ z) & mask) * features,
        begin + ((c ^ k) & mask) * features,
        begin + ((c ^ z) & mask) * features,
        begin + ((d ^ k) & mask) * features,
        begin + ((d ^ z) & mask) * features,
    )


@inline
def _encode(table, layout, x, features, feature):
    """feature[level * F + f] of one warped point."""
    count = np.int64(len(features))
    for level in range(len(layout)):
        i, fx = _split(x[0], layout[level, 0])
        j, fy = _split(x[1], layout[level, 0])
        k, fz = _split(x[2], layout[level, 0])
        o0, o1, o2, o3, o4, o5, o6, o7 = _corners(layout, level, i, j, k, count)
        trilinear_row(table, o0, o1, o2, o3, o4, o5, o6, o7, fx, fy, fz, feature, level * count, features)


@inline
def _scatter(layout, x, features, feature_gradient, flat, base):
    """Add dL/d(table) of _encode to flat[base:]."""
    count = np.int64(len(features))
    for level in range(len(layout)):
        i, fx = _split(x[0], layout[level, 0])
        j, fy = _split(x[1], layout[level, 0])
        k, fz = _split(x[2], layout[level, 0])
        o0, o1, o2, o3, o4, o5, o6, o7 = _corners(layout, level, i, j, k, count)
        trilinear_row_backward(
            flat, base, o0, o1, o2, o3, o4, o5, o6, o7, fx, fy, fz, feature_gradient, level * count, features
        )


@parallel_kernel
def colour(values, layout, features, width, x, starts, ends, weights, least, chunks, out):
    """Colours sigmoid(bias + head . features) of samples with weight > `least`; others get -1 in channel 0.

    features, width: tuples of F and levels * F elements (their lengths are compile-time constants).
    """
    n = len(ends)
    wide = np.int64(len(width))
    bias = len(values) - 3
    head = bias - 3 * wide
    for c in prange(chunks):
        feature = np.empty(wide, np.float32)
        for r in range(c * n // chunks, (c + 1) * n // chunks):
            for k in range(starts[r], ends[r]):
                if weights[k] <= least:
                    out[k, 0] = -_ONE
                    continue
                _encode(values, layout, x[k], features, feature)
                for j in range(3):
                    z = values[bias + j] + dot_rows(values, head + j * wide, feature, np.int64(0), width)
                    out[k, j] = _ONE / (_ONE + np.float32(math.exp(-z)))


@parallel_kernel
def colour_backward(values, layout, features, width, x, starts, ends, colours, colour_gradients, chunks, to):
    """Add dL/d(values) to the chunk's buffer to[chunk]; samples with colours[k, 0] < 0 are skipped."""
    n = len(ends)
    wide = np.int64(len(width))
    stride = to.shape[1]
    flat = to.reshape(-1)
    bias = stride - 3
    head = bias - 3 * wide
    for c in prange(chunks):
        base = np.int64(c * stride)
        feature = np.empty(wide, np.float32)
        feature_gradient = np.empty(wide, np.float32)
        for r in range(c * n // chunks, (c + 1) * n // chunks):
            for k in range(starts[r], ends[r]):
                if colours[k, 0] < _ZERO:
                    continue
                _encode(values, layout, x[k], features, feature)
                feature_gradient[:] = _ZERO
                for j in range(3):
                    g = colour_gradients[k, j] * colours[k, j] * (_ONE - colours[k, j])
                    flat[base + bias + j] += g
                    axpy_row(g, values, head + j * wide, feature_gradient, np.int64(0), width)
                    axpy_row(g, feature, np.int64(0), flat, base + head + j * wide, width)
                _scatter(layout, x[k], features, feature_gradient, flat, base)
