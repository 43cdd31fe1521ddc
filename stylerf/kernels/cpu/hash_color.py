"""A multi-resolution hash grid (Mueller et al. 2022) as a color that does not depend on the view.

Level l is a grid of resolution[l]^3 cells whose vertices carry four floats. A level whose (resolution + 1)^3 vertices
fit its table is indexed directly, others by iz ^ iy 2654435761 ^ ix 805459861 modulo the table's length (2^k).
The interpolated values of all levels sum to f (4); the color is sigmoid(f[0:3] + f[3]).

The grid feeds no network: docs/decisions/0008 has the measurements.
"""

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import inline, parallel_kernel
from stylerf.kernels.cpu.march import end_of_partition
from stylerf.kernels.cpu.simd_hash import hash_features_backward, hash_logits, hash_prefetch, hash_slopes, sigmoid_three

_ONE, _ZERO = np.float32(1), np.float32(0)


@parallel_kernel
def color(table, layout, levels, points, threads, out):
    """Colors of points with a positive weight; others get -1 in channel 0.

    layout: int32 [6, levels], see simd_hash.py. levels: a tuple as long as there are levels (a compile-time constant).
    """
    starts, ends, x, weights = points
    n = len(ends)
    flat = out.reshape(-1)
    for thread in prange(threads):
        stop = end_of_partition(ends, thread, threads)
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            for k in range(starts[r], ends[r]):
                if weights[k] <= _ZERO:
                    out[k, 0] = -_ONE
                    continue
                if k + 1 < stop and weights[k + 1] > _ZERO:
                    hash_prefetch(table, np.int64(0), layout, x[k + 1, 0], x[k + 1, 1], x[k + 1, 2], levels)
                hash_logits(table, layout, x[k, 0], x[k, 1], x[k, 2], flat, k * 3, levels)
            # A separate loop, so that the long dependency chains of successive exponentials overlap.
            for k in range(starts[r], ends[r]):
                if weights[k] > _ZERO:
                    sigmoid_three(flat, k * 3)


@inline
def _logit_gradient(colors, color_gradients, k, g):
    """g = dL/df of sample k: the three logits are f[0:3] + f[3]."""
    for j in range(3):
        g[j] = color_gradients[k, j] * colors[k, j] * (_ONE - colors[k, j])
    g[3] = g[0] + g[1] + g[2]


@parallel_kernel
def color_backward(layout, levels, points, colors, color_gradients, to):
    """Add dL/d(table) to the thread's buffer to[thread]; points with colors[k, 0] < 0 are skipped."""
    starts, ends, x = points.starts, points.ends, points.x
    n = len(ends)
    threads, stride = to.shape
    flat = to.reshape(-1)
    for thread in prange(threads):
        base = np.int64(thread * stride)
        g = np.empty(4, np.float32)
        stop = end_of_partition(ends, thread, threads)
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            for k in range(starts[r], ends[r]):
                if colors[k, 0] < _ZERO:
                    continue
                if k + 1 < stop and colors[k + 1, 0] >= _ZERO:
                    hash_prefetch(flat, base, layout, x[k + 1, 0], x[k + 1, 1], x[k + 1, 2], levels)
                _logit_gradient(colors, color_gradients, k, g)
                hash_features_backward(flat, base, layout, x[k, 0], x[k, 1], x[k, 2], g, np.int64(0), levels)


@parallel_kernel
def color_position_gradient(table, layout, levels, points, colors, color_gradients, threads, position_gradients):
    """Add dL/dx [n, 3] of points that have a color; the slope is that of the cell that a point lies in."""
    starts, ends, x = points.starts, points.ends, points.x
    n = len(ends)
    flat = position_gradients.reshape(-1)
    for thread in prange(threads):
        g = np.empty(4, np.float32)
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            for k in range(starts[r], ends[r]):
                if colors[k, 0] >= _ZERO:
                    _logit_gradient(colors, color_gradients, k, g)
                    hash_slopes(table, layout, x[k, 0], x[k, 1], x[k, 2], g, np.int64(0), flat, k * 3, levels)
