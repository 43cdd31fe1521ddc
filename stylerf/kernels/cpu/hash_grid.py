"""A multi-resolution hash grid (Mueller et al. 2022) as a color, as a density, and as features for a color head.

Level l is a grid of resolution[l]^3 cells with four floats per vertex, or one for a density. A level whose
(resolution + 1)^3 vertices fit in its table is indexed directly, others by iz ^ iy 2654435761 ^ ix 805459861 modulo the
table's length (2^k). layout: int32 [6, levels], see simd_hash.py. levels: a tuple whose length is the number of levels
(a compile-time constant).
"""

import math

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import inline, parallel_kernel
from stylerf.kernels.cpu.march import EXPONENT_MAX, EXPONENT_MIN, end_of_partition, march_partition, no_prefetch
from stylerf.kernels.cpu.simd_hash import (
    hash_features_backward,
    hash_logits,
    hash_prefetch,
    hash_rows,
    hash_rows_backward,
    hash_rows_slopes,
    hash_slopes,
    hash_sum,
    hash_sum_backward,
    hash_sum_slopes,
    sigmoid_three,
)

_ONE, _ZERO = np.float32(1), np.float32(0)


# -- color -------------------------------------------------------------------------------------------------------------


@parallel_kernel
def color(table, layout, levels, points, threads, out):
    """Compute colors of points with positive weight; others get -1 in channel 0.

    The levels' values add up to f (4); the color is sigmoid(f[0:3] + f[3]), without a network (decision 0008).
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
    """g = dL/df of sample k; the three logits are f[0:3] + f[3]."""
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
                    # The gradients' rows; the table is not read, since a sigmoid's derivative follows from its value.
                    hash_prefetch(flat, base, layout, x[k + 1, 0], x[k + 1, 1], x[k + 1, 2], levels)
                _logit_gradient(colors, color_gradients, k, g)
                hash_features_backward(flat, base, layout, x[k, 0], x[k, 1], x[k, 2], g, np.int64(0), levels)


@parallel_kernel
def color_position_gradient(table, layout, levels, points, colors, color_gradients, threads, position_gradients):
    """Add dL/dx [n, 3] for colored points; the slope is that of the cell that contains the point."""
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


# -- density -----------------------------------------------------------------------------------------------------------


@inline
def raw_density(density, levels, x):
    """Return exp(shift + levels) at one warped point, with the exponent clamped to [-15, 12]."""
    total = density.shift + hash_sum(density.table, density.layout, x[0], x[1], x[2], levels)
    return np.float32(math.exp(min(max(total, EXPONENT_MIN), EXPONENT_MAX)))


@parallel_kernel
def density_at(density, levels, x, threads, sigma):
    """sigma [n] = raw density at warped points x [n, 3]."""
    n = len(x)
    for thread in prange(threads):
        for p in range(thread * n // threads, (thread + 1) * n // threads):
            sigma[p] = raw_density(density, levels, x[p])


@parallel_kernel
def march_density(density, levels, rays, space, occupancy, displacement, settings, threads, samples):
    """March rays through a hash density; see march.march_partition and vm.march_density."""
    for thread in prange(threads):
        march_partition(
            raw_density, no_prefetch, density, levels, rays, space, occupancy, displacement, settings, thread, threads,
            samples,
        )  # fmt: skip


@parallel_kernel
def density_backward(density, levels, samples, sigma_gradients, to):
    """Add dL/d(table) and, after the table's last element, dL/d(shift) to the thread's buffer to[thread]."""
    layout = density.layout
    starts, ends, x, sigma = samples.starts, samples.ends, samples.x, samples.sigma
    n = len(ends)
    threads, stride = to.shape
    flat = to.reshape(-1)
    for thread in prange(threads):
        shift_gradient = _ZERO
        base = np.int64(thread * stride)
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            for k in range(starts[r], ends[r]):
                g = sigma_gradients[k] * sigma[k]  # exp'(e) = exp(e), even beyond the clamp, or e could not return
                if g != _ZERO:
                    shift_gradient += g
                    hash_sum_backward(flat, base, layout, x[k, 0], x[k, 1], x[k, 2], g, levels)
        to[thread, stride - 1] += shift_gradient


@parallel_kernel
def density_position_gradient(density, levels, samples, sigma_gradients, threads, position_gradients):
    """Add dL/dx [n, 3]; the slope is that of the cell that contains the sample."""
    table, layout = density.table, density.layout
    starts, ends, x, sigma = samples.starts, samples.ends, samples.x, samples.sigma
    n = len(ends)
    flat = position_gradients.reshape(-1)
    for thread in prange(threads):
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            for k in range(starts[r], ends[r]):
                g = sigma_gradients[k] * sigma[k]
                if g != _ZERO:
                    hash_sum_slopes(table, layout, x[k, 0], x[k, 1], x[k, 2], g, flat, k * 3, levels)


@parallel_kernel
def smoothness_backward(table, cells, first, width, strength, to):
    """Add strength * d/dt of half the sum of squared differences between neighboring vertices of one direct level."""
    n = cells + 1
    # Every pair is visited from both ends, and a vertex writes only its own gradient, so there are no races.
    for i in prange(n):
        for j in range(n):
            for k in range(n):
                here = first + ((i * n + j) * n + k) * width
                for f in range(width):
                    own = table[here + f]
                    s = _ZERO
                    if i > 0:
                        s += own - table[here + f - n * n * width]
                    if i < cells:
                        s += own - table[here + f + n * n * width]
                    if j > 0:
                        s += own - table[here + f - n * width]
                    if j < cells:
                        s += own - table[here + f + n * width]
                    if k > 0:
                        s += own - table[here + f - width]
                    if k < cells:
                        s += own - table[here + f + width]
                    to[here + f] += strength * s


# -- features of selected samples, for a color head --------------------------------------------------------------------


@parallel_kernel
def features(table, layout, levels, x, index, threads, out):
    """out [m, 4 levels] for samples x[index[i]] in 0..1: the levels concatenated."""
    n, width = out.shape
    flat = out.reshape(-1)
    for thread in prange(threads):
        for i in range(thread * n // threads, (thread + 1) * n // threads):
            k = index[i]
            hash_rows(table, layout, x[k, 0], x[k, 1], x[k, 2], flat, np.int64(i * width), levels)


@parallel_kernel
def features_backward(table, layout, levels, x, index, gradients, threads, to):
    """Add dL/d(table) to the thread's buffer to[thread]; gradients [m, 4 levels] = dL/d(out)."""
    n, width = gradients.shape
    stride = to.shape[1]
    buffers, flat = to.reshape(-1), gradients.reshape(-1)
    for thread in prange(threads):
        base = np.int64(thread * stride)
        for i in range(thread * n // threads, (thread + 1) * n // threads):
            k = index[i]
            hash_rows_backward(buffers, base, layout, x[k, 0], x[k, 1], x[k, 2], flat, np.int64(i * width), levels)


@parallel_kernel
def features_position_gradient(table, layout, levels, x, index, gradients, threads, position_gradients):
    """Add dL/dx of the selected samples to position_gradients [n, 3]."""
    n, width = gradients.shape
    flat, out = gradients.reshape(-1), position_gradients.reshape(-1)
    for thread in prange(threads):
        for i in range(thread * n // threads, (thread + 1) * n // threads):
            k = index[i]
            hash_rows_slopes(
                table, layout, x[k, 0], x[k, 1], x[k, 2], flat, np.int64(i * width), out, np.int64(k * 3), levels
            )
