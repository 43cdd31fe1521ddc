"""encode, hash: a multi-resolution hash grid (Mueller et al. 2022) as a density.

The grid is that of hash_color.py with one float a vertex. Raw density is exp(shift + sum of all levels' trilinear
mixes), the exponent clamped to [-15, 12].
"""

import math

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import inline, parallel_kernel
from stylerf.kernels.cpu.march import EXPONENT_MAX, EXPONENT_MIN, fetch_nothing, walk_chunk
from stylerf.kernels.cpu.simd_hash_density import hash_sum, hash_sum_backward, hash_sum_slopes

_ZERO = np.float32(0)


@inline
def raw_density(table, layout, shift, levels, x):
    """exp(shift + levels) of one warped point."""
    total = shift + hash_sum(table, layout, x[0], x[1], x[2], levels)
    return np.float32(math.exp(min(max(total, EXPONENT_MIN), EXPONENT_MAX)))


@parallel_kernel
def density(table, layout, shift, levels, x, chunks, sigma):
    """Raw density of warped points x [n, 3]."""
    n = len(x)
    for c in prange(chunks):
        for p in range(c * n // chunks, (c + 1) * n // chunks):
            sigma[p] = raw_density(table, layout, shift, levels, x[p])


@parallel_kernel
def march_density(
    kind,
    space,
    origins,
    directions,
    jitter,
    near,
    far,
    step,
    occupancy,
    cells,
    limit,
    table,
    layout,
    shift,
    levels,
    displacement,
    displacement_cells,
    opaque,
    closed,
    chunks,
    starts,
    ends,
    t_out,
    optical,
    x,
    sigma,
    weights,
):
    """Walk rays through a hash density: see march.walk_chunk."""
    for c in prange(chunks):
        walk_chunk(
            raw_density,
            fetch_nothing,
            table,
            layout,
            shift,
            levels,
            kind,
            space,
            origins,
            directions,
            jitter,
            near,
            far,
            step,
            occupancy,
            cells,
            limit,
            displacement,
            displacement_cells,
            opaque,
            closed,
            c,
            chunks,
            starts,
            ends,
            t_out,
            optical,
            x,
            sigma,
            weights,
        )


@parallel_kernel
def density_backward(layout, levels, x, starts, ends, sigma, sigma_gradients, chunks, to):
    """Add dL/d(table) and, behind the table's last element, dL/d(shift) to the chunk's own buffer to[chunk]."""
    n = len(ends)
    stride = to.shape[1]
    flat = to.reshape(-1)
    for c in prange(chunks):
        shift_gradient = _ZERO
        base = np.int64(c * stride)
        for r in range(c * n // chunks, (c + 1) * n // chunks):
            for k in range(starts[r], ends[r]):
                g = sigma_gradients[k] * sigma[k]  # d exp(e)/de = exp(e)
                if g != _ZERO:
                    shift_gradient += g
                    hash_sum_backward(flat, base, layout, x[k, 0], x[k, 1], x[k, 2], g, levels)
        to[c, stride - 1] += shift_gradient


@parallel_kernel
def density_position_gradient(
    table, layout, levels, x, starts, ends, sigma, sigma_gradients, chunks, position_gradients
):
    """Add dL/dx [n, 3]; the slope is that of the cell a sample lies in."""
    n = len(ends)
    flat = position_gradients.reshape(-1)
    for c in prange(chunks):
        for r in range(c * n // chunks, (c + 1) * n // chunks):
            for k in range(starts[r], ends[r]):
                g = sigma_gradients[k] * sigma[k]
                if g != _ZERO:
                    hash_sum_slopes(table, layout, x[k, 0], x[k, 1], x[k, 2], g, flat, k * 3, levels)


@parallel_kernel
def smoothness_backward(table, cells, first, width, strength, to):
    """Add strength * d/dt of half the summed squared differences between neighboring vertices of one direct level."""
    n = cells + 1
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
