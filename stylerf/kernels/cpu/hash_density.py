"""A multi-resolution hash grid (Mueller et al. 2022) as a density.

The grid is that of hash_color.py with one float a vertex. Raw density is exp(shift + sum of all levels'
interpolated values), the exponent clamped to [-15, 12].
"""

import math

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import inline, parallel_kernel
from stylerf.kernels.cpu.march import EXPONENT_MAX, EXPONENT_MIN, march_partition, no_prefetch
from stylerf.kernels.cpu.simd_hash_density import hash_sum, hash_sum_backward, hash_sum_slopes

_ZERO = np.float32(0)


@inline
def raw_density(density, levels, x):
    """exp(shift + levels) of one warped point."""
    total = density.shift + hash_sum(density.table, density.layout, x[0], x[1], x[2], levels)
    return np.float32(math.exp(min(max(total, EXPONENT_MIN), EXPONENT_MAX)))


@parallel_kernel
def density_at(density, levels, x, threads, sigma):
    """sigma [n]: raw density of warped points x [n, 3]."""
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
def density_backward(layout, levels, samples, sigma_gradients, to):
    """Add dL/d(table) and, behind the table's last element, dL/d(shift) to the thread's own buffer to[thread]."""
    starts, ends, x, sigma = samples.starts, samples.ends, samples.x, samples.sigma
    n = len(ends)
    threads, stride = to.shape
    flat = to.reshape(-1)
    for thread in prange(threads):
        shift_gradient = _ZERO
        base = np.int64(thread * stride)
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            for k in range(starts[r], ends[r]):
                g = sigma_gradients[k] * sigma[k]  # d exp(e)/de = exp(e)
                if g != _ZERO:
                    shift_gradient += g
                    hash_sum_backward(flat, base, layout, x[k, 0], x[k, 1], x[k, 2], g, levels)
        to[thread, stride - 1] += shift_gradient


@parallel_kernel
def density_position_gradient(table, layout, levels, samples, sigma_gradients, threads, position_gradients):
    """Add dL/dx [n, 3]; the slope is that of the cell a sample lies in."""
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
