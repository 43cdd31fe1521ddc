"""Vector-matrix fields (TensoRF, Chen et al. 2022, eq. 7) as density, as spherical-harmonic color and as features.

A table is one flat float32 array: for m = 0, 1, 2 a plane [size[a], size[b], rank] over axes a = (m+1)%3, b = (m+2)%3,
then for m = 0, 1, 2 a line [size[m], rank] over axis m. A sample's feature m, r is bilinear(plane m, r) * linear(line
m, r). Raw density is exp(shift + sum of all features), with the exponent clamped to [-15, 12].
"""

import math

import numpy as np
from numba import prange

from stylerf.kernels.cpu.color_heads import head_of
from stylerf.kernels.cpu.compiling import inline, parallel_kernel
from stylerf.kernels.cpu.march import EXPONENT_MAX, EXPONENT_MIN, cell, end_of_partition, march_partition
from stylerf.kernels.cpu.simd_vm import (
    add_roughness,
    axpy_row,
    vm_dot_backward,
    vm_features,
    vm_features_backward,
    vm_features_slopes,
    vm_prefetch,
    vm_projected,
    vm_projected_backward,
    vm_slopes,
    vm_sum,
)

_ONE, _ZERO = np.float32(1), np.float32(0)


@inline
def place(m, x, size, rank):
    """Return row offsets in the table and cell positions of point x for plane m."""
    a, b = (m + 1) % 3, (m + 2) % 3
    iu, fu = cell(x[a], size[a])
    iv, fv = cell(x[b], size[b])
    iw, fw = cell(x[m], size[m])
    # All planes are stored before the lines.
    at = np.int64(0)
    for before in range(m):
        at += size[(before + 1) % 3] * size[(before + 2) % 3]
    lines = size[0] * size[1] + size[1] * size[2] + size[2] * size[0]
    for before in range(m):
        lines += size[before]
    first = (at + iu * size[b] + iv) * rank
    return first, first + size[b] * rank, (lines + iw) * rank, fu, fv, fw


@inline
def places(x, size, rank):
    """Return place() for all three planes."""
    return place(0, x, size, rank), place(1, x, size, rank), place(2, x, size, rank)


@inline
def raw_density(density, ranks, x):
    """Return exp(shift + features) at one warped point."""
    total = density.shift + vm_sum(density.table, *places(x, density.layout, np.int64(len(ranks))), ranks)
    return np.float32(math.exp(min(max(total, EXPONENT_MIN), EXPONENT_MAX)))


@inline
def prefetch(density, ranks, x):
    """Prefetch the rows for one warped point."""
    vm_prefetch(density.table, np.int64(0), *places(x, density.layout, np.int64(len(ranks))), ranks)


@parallel_kernel
def density_at(density, ranks, x, threads, sigma):
    """sigma [n] = raw density at warped points x [n, 3]."""
    n = len(x)
    for thread in prange(threads):
        for p in range(thread * n // threads, (thread + 1) * n // threads):
            sigma[p] = raw_density(density, ranks, x[p])


@parallel_kernel
def march_density(density, ranks, rays, space, occupancy, displacement, settings, threads, samples):
    """March rays through a vm density; see march.march_partition.

    Every density has its own copy of this kernel instead of a factory: numba keys the cache of a closure over other
    compiled functions by ids that differ between processes, so every run would recompile it.
    """
    for thread in prange(threads):
        march_partition(
            raw_density, prefetch, density, ranks, rays, space, occupancy, displacement, settings, thread, threads,
            samples,
        )  # fmt: skip


@parallel_kernel
def density_backward(density, ranks, samples, sigma_gradients, to):
    """Add dL/d(table) and, after the table's last element, dL/d(shift) to the thread's buffer to[thread]."""
    table, size = density.table, density.layout
    starts, ends, x, sigma = samples.starts, samples.ends, samples.x, samples.sigma
    n = len(ends)
    threads, stride = to.shape
    flat = to.reshape(-1)
    for thread in prange(threads):
        stop = end_of_partition(ends, thread, threads)
        base = np.int64(thread * stride)
        shift_gradient = _ZERO
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            for k in range(starts[r], ends[r]):
                g = sigma_gradients[k] * sigma[k]  # exp'(e) = exp(e), even beyond the clamp, or e could not return
                if g != _ZERO:
                    shift_gradient += g
                    if k + 1 < stop:
                        following = places(x[k + 1], size, np.int64(len(ranks)))
                        # The table and the thread's gradients are accessed at the same offsets.
                        vm_prefetch(table, np.int64(0), *following, ranks)
                        vm_prefetch(flat, base, *following, ranks)
                    for m in range(3):
                        first, second, line, fu, fv, fw = place(m, x[k], size, np.int64(len(ranks)))
                        vm_dot_backward(table, first, second, line, fu, fv, fw, g, flat, base, ranks)
        to[thread, stride - 1] += shift_gradient


@parallel_kernel
def density_position_gradient(density, ranks, samples, sigma_gradients, threads, position_gradients):
    """Add dL/dx [n, 3] of a vm density; the slope is that of the cell that contains the sample."""
    table, size = density.table, density.layout
    starts, ends, x, sigma = samples.starts, samples.ends, samples.x, samples.sigma
    n = len(ends)
    for thread in prange(threads):
        slopes = np.empty(3, np.float32)
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            for k in range(starts[r], ends[r]):
                g = sigma_gradients[k] * sigma[k]
                if g != _ZERO:
                    for m in range(3):
                        first, second, line, fu, fv, fw = place(m, x[k], size, np.int64(len(ranks)))
                        vm_slopes(table, first, second, line, fu, fv, fw, slopes, ranks)
                        for axis in range(3):
                            # Plane m's u, v, w are axes m + 1, m + 2, m; slopes are per cell, with size - 1 cells.
                            along = (m + 1 + axis) % 3
                            position_gradients[k, along] += g * slopes[axis] * np.float32(size[along] - 1)


@parallel_kernel
def color(parameters, ranks, points, basis, threads, out):
    """Color points with positive weight: sigmoid(sum_b basis_b (head_b . features) + bias); others: -1 in channel 0.

    parameters: LinearColor. basis [rays, bands]: spherical harmonics of the ray directions. out [n, 3].
    """
    table, size, head, bias = parameters
    starts, ends, x, weights = points
    n = len(ends)
    rank = np.int64(len(ranks))
    width = 3 * rank
    for thread in prange(threads):
        ray_head = np.empty(3 * width, np.float32)
        z = np.empty(3, np.float32)
        stop = end_of_partition(ends, thread, threads)
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            ready = False
            for k in range(starts[r], ends[r]):
                if weights[k] <= _ZERO:
                    out[k, 0] = -_ONE
                    continue
                if k + 1 < stop and weights[k + 1] > _ZERO:
                    vm_prefetch(table, np.int64(0), *places(x[k + 1], size, rank), ranks)
                # Head for the direction, once per ray and only if the ray has a sample to color.
                if not ready:
                    head_of(head, basis, r, width, ray_head)
                    ready = True
                vm_projected(table, *places(x[k], size, rank), ray_head, z, ranks)
                for j in range(3):
                    out[k, j] = _ONE / (_ONE + np.float32(math.exp(-(bias[j] + z[j]))))


@parallel_kernel
def color_backward(parameters, ranks, points, basis, colors, color_gradients, to):
    """Add dL/d(table), dL/d(head) and dL/d(bias) to the thread's buffer to[thread], which has that layout.

    colors, color_gradients [n, 3]: the forward pass's result and dL/dc; points with colors[k, 0] < 0 are skipped.
    """
    table, size, head = parameters.table, parameters.size, parameters.head
    starts, ends, x = points.starts, points.ends, points.x
    n = len(ends)
    bands = basis.shape[1]
    rank = np.int64(len(ranks))
    width = 3 * rank
    threads, stride = to.shape
    flat = to.reshape(-1)
    head_at = stride - 3 - 3 * bands * width
    for thread in prange(threads):
        base = np.int64(thread * stride)
        ray_head = np.empty(3 * width, np.float32)
        ray_head_gradient = np.empty(3 * width, np.float32)
        g = np.empty(3, np.float32)
        stop = end_of_partition(ends, thread, threads)
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            ready = False
            for k in range(starts[r], ends[r]):
                if colors[k, 0] < _ZERO:
                    continue
                if k + 1 < stop and colors[k + 1, 0] >= _ZERO:
                    following = places(x[k + 1], size, rank)
                    vm_prefetch(table, np.int64(0), *following, ranks)
                    vm_prefetch(flat, base, *following, ranks)
                if not ready:
                    head_of(head, basis, r, width, ray_head)
                    ray_head_gradient[:] = _ZERO
                    ready = True
                for j in range(3):
                    g[j] = color_gradients[k, j] * colors[k, j] * (_ONE - colors[k, j])
                    to[thread, stride - 3 + j] += g[j]
                where = places(x[k], size, rank)
                vm_projected_backward(table, *where, ray_head, g[0], g[1], g[2], ray_head_gradient, flat, base, ranks)
            if ready:
                for j in range(3):
                    for b in range(bands):
                        # The ray's head is sum_b Y_b head_b, so band b gets its gradient times Y_b.
                        w = basis[r, b]
                        for m in range(3):
                            axpy_row(
                                w,
                                ray_head_gradient,
                                j * width + m * rank,
                                flat,
                                base + head_at + (j * bands + b) * width + m * rank,
                                ranks,
                            )


@parallel_kernel
def color_position_gradient(parameters, ranks, points, basis, colors, color_gradients, threads, position_gradients):
    """Add dL/dx [n, 3] of vm colors; parameters, basis, colors as in color(). Uncolored points are skipped."""
    table, size, head = parameters.table, parameters.size, parameters.head
    starts, ends, x = points.starts, points.ends, points.x
    n = len(ends)
    rank = np.int64(len(ranks))
    width = 3 * rank
    for thread in prange(threads):
        ray_head, gradient = np.empty(3 * width, np.float32), np.empty(width, np.float32)
        slopes = np.empty(3, np.float32)
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            ready = False
            for k in range(starts[r], ends[r]):
                if colors[k, 0] < _ZERO:
                    continue
                if not ready:
                    head_of(head, basis, r, width, ray_head)
                    ready = True
                gradient[:] = _ZERO
                for j in range(3):
                    g = color_gradients[k, j] * colors[k, j] * (_ONE - colors[k, j])
                    for m in range(3):
                        axpy_row(g, ray_head, j * width + m * rank, gradient, m * rank, ranks)
                for m in range(3):
                    first, second, line, fu, fv, fw = place(m, x[k], size, rank)
                    vm_features_slopes(table, first, second, line, fu, fv, fw, gradient, m * rank, slopes, ranks)
                    for axis in range(3):
                        along = (m + 1 + axis) % 3
                        position_gradients[k, along] += slopes[axis] * np.float32(size[along] - 1)


@parallel_kernel
def smoothness_backward(table, size, ranks, strength, to):
    """Add strength * d/dt of half the sum of squared differences between neighboring plane texels to to[...]."""
    rank = np.int64(len(ranks))
    at = np.int64(0)
    for m in range(3):
        rows, columns = size[(m + 1) % 3], size[(m + 2) % 3]
        across = columns * rank
        # As in hash_grid.py, a texel writes only its own gradient, so threads share one buffer without races.
        for i in prange(rows):
            for j in range(columns):
                here = at + (i * columns + j) * rank
                # At an edge, the texel replaces its missing neighbor: their difference is zero.
                above = here - across if i > 0 else here
                below = here + across if i < rows - 1 else here
                left = here - rank if j > 0 else here
                right = here + rank if j < columns - 1 else here
                add_roughness(table, here, above, below, left, right, strength, to, ranks)
        at += rows * across


# -- features of selected samples, for a color head --------------------------------------------------------------------


@parallel_kernel
def features(table, size, ranks, x, index, threads, out):
    """out [m, 3 rank] for samples x[index[i]] in 0..1."""
    n, width = out.shape
    rank = np.int64(len(ranks))
    flat = out.reshape(-1)
    for thread in prange(threads):
        for i in range(thread * n // threads, (thread + 1) * n // threads):
            for m in range(3):
                first, second, line, fu, fv, fw = place(m, x[index[i]], size, rank)
                vm_features(table, first, second, line, fu, fv, fw, flat, np.int64(i * width + m * rank), ranks)


@parallel_kernel
def features_backward(table, size, ranks, x, index, gradients, threads, to):
    """Add dL/d(table) to the thread's buffer to[thread]; gradients [m, 3 rank] = dL/d(out)."""
    n, width = gradients.shape
    rank, stride = np.int64(len(ranks)), to.shape[1]
    buffers, flat = to.reshape(-1), gradients.reshape(-1)
    for thread in prange(threads):
        base = np.int64(thread * stride)
        for i in range(thread * n // threads, (thread + 1) * n // threads):
            for m in range(3):
                first, second, line, fu, fv, fw = place(m, x[index[i]], size, rank)
                here = np.int64(i * width + m * rank)
                vm_features_backward(table, first, second, line, fu, fv, fw, flat, here, buffers, base, ranks)


@parallel_kernel
def features_position_gradient(table, size, ranks, x, index, gradients, threads, position_gradients):
    """Add dL/dx of the selected samples to position_gradients [n, 3]."""
    n, width = gradients.shape
    rank = np.int64(len(ranks))
    flat = gradients.reshape(-1)
    for thread in prange(threads):
        slopes = np.empty(3, np.float32)
        for i in range(thread * n // threads, (thread + 1) * n // threads):
            k = index[i]
            for m in range(3):
                first, second, line, fu, fv, fw = place(m, x[k], size, rank)
                here = np.int64(i * width + m * rank)
                vm_features_slopes(table, first, second, line, fu, fv, fw, flat, here, slopes, ranks)
                for axis in range(3):
                    along = (m + 1 + axis) % 3
                    position_gradients[k, along] += slopes[axis] * np.float32(size[along] - 1)
