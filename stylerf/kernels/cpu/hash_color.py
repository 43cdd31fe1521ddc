"""encode, hash: a multi-resolution hash grid (Mueller et al. 2022) as a color that does not depend on the view.

Level l is a grid of resolution[l]^3 cells whose vertices carry four floats. A level whose (resolution + 1)^3 vertices
fit its table is indexed directly, others by iz ^ iy 2654435761 ^ ix 805459861 modulo the table's length (2^k).
The trilinear mixes of all levels add up to f (4); the color is sigmoid(f[0:3] + f[3]).

No network stands behind the grid: docs/decisions/0008 has the measurements.
"""

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import inline, parallel_kernel
from stylerf.kernels.cpu.march import end_of_chunk
from stylerf.kernels.cpu.simd_hash import hash_features_backward, hash_logits, hash_prefetch, hash_slopes, sigmoid_three

_ONE, _ZERO = np.float32(1), np.float32(0)


@parallel_kernel
def color(table, layout, levels, x, starts, ends, weights, least, chunks, out):
    """Colors of samples with weight > `least`; others get -1 in channel 0.

    layout: int32 [6, levels], see vector_hash. levels: a tuple as long as there are levels (a compile-time constant).
    """
    n = len(ends)
    flat = out.reshape(-1)
    for c in prange(chunks):
        stop = end_of_chunk(ends, c, chunks)
        for r in range(c * n // chunks, (c + 1) * n // chunks):
            for k in range(starts[r], ends[r]):
                if weights[k] <= least:
                    out[k, 0] = -_ONE
                    continue
                if k + 1 < stop and weights[k + 1] > least:
                    hash_prefetch(table, np.int64(0), layout, x[k + 1, 0], x[k + 1, 1], x[k + 1, 2], levels)
                hash_logits(table, layout, x[k, 0], x[k, 1], x[k, 2], flat, k * 3, levels)
            # A loop of its own: the long chain of one sample's exponential overlaps with the next one's.
            for k in range(starts[r], ends[r]):
                if weights[k] > least:
                    sigmoid_three(flat, k * 3)


@inline
def _logit_gradient(colors, color_gradients, k, g):
    """g = dL/df of sample k: the three logits are f[0:3] + f[3]."""
    for j in range(3):
        g[j] = color_gradients[k, j] * colors[k, j] * (_ONE - colors[k, j])
    g[3] = g[0] + g[1] + g[2]


@parallel_kernel
def color_backward(layout, levels, x, starts, ends, colors, color_gradients, chunks, to):
    """Add dL/d(table) to the chunk's buffer to[chunk]; samples with colors[k, 0] < 0 are skipped."""
    n = len(ends)
    stride = to.shape[1]
    flat = to.reshape(-1)
    for c in prange(chunks):
        base = np.int64(c * stride)
        g = np.empty(4, np.float32)
        stop = end_of_chunk(ends, c, chunks)
        for r in range(c * n // chunks, (c + 1) * n // chunks):
            for k in range(starts[r], ends[r]):
                if colors[k, 0] < _ZERO:
                    continue
                if k + 1 < stop and colors[k + 1, 0] >= _ZERO:
                    hash_prefetch(flat, base, layout, x[k + 1, 0], x[k + 1, 1], x[k + 1, 2], levels)
                _logit_gradient(colors, color_gradients, k, g)
                hash_features_backward(flat, base, layout, x[k, 0], x[k, 1], x[k, 2], g, np.int64(0), levels)


@parallel_kernel
def color_position_gradient(
    table, layout, levels, x, starts, ends, colors, color_gradients, chunks, position_gradients
):
    """Add dL/dx [n, 3] of the samples that have a color; the grid's slope is that of the cell a sample lies in."""
    n = len(ends)
    flat = position_gradients.reshape(-1)
    for c in prange(chunks):
        g = np.empty(4, np.float32)
        for r in range(c * n // chunks, (c + 1) * n // chunks):
            for k in range(starts[r], ends[r]):
                if colors[k, 0] >= _ZERO:
                    _logit_gradient(colors, color_gradients, k, g)
                    hash_slopes(table, layout, x[k, 0], x[k, 1], x[k, 2], g, np.int64(0), flat, k * 3, levels)
