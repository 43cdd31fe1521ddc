"""A sparse voxel grid, interpolated trilinearly (ARF; Plenoxels, Fridovich-Keil et al. 2022).

Vertices are allocated in blocks of 4 x 4 x 4, with one row of numbers each. links: int32, the grid's vertices per axis
(3), its blocks per axis (3), then each block's index in the table (x slowest); all blocks that are not allocated share
block 0. A row's index is ((link * 4 + i % 4) * 4 + j % 4) * 4 + k % 4. Raw density is exp(shift + interpolated value),
with the exponent clamped to [-15, 12].
"""

import math

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import inline, parallel_kernel
from stylerf.kernels.cpu.march import EXPONENT_MAX, EXPONENT_MIN, cell, march_partition, no_prefetch
from stylerf.kernels.cpu.simd_voxel import voxel_row, voxel_row_backward, voxel_row_slopes

_ZERO = np.float32(0)


@inline
def row_of(links, i, j, k):
    """Return the row of vertex i, j, k in the table."""
    block = (np.int64(i >> 2) * links[4] + (j >> 2)) * links[5] + (k >> 2)
    return (np.int64(links[6 + block]) << 6) | ((i & 3) << 4) | ((j & 3) << 2) | (k & 3)


@inline
def corners(links, x, width, offsets):
    """Write the table offsets of the eight vertices around x; return x's position in their cell."""
    i, fx = cell(x[0], np.int64(links[0]))
    j, fy = cell(x[1], np.int64(links[1]))
    k, fz = cell(x[2], np.int64(links[2]))
    for corner in range(8):
        offsets[corner] = row_of(links, i + (corner >> 2), j + ((corner >> 1) & 1), k + (corner & 1)) * width
    return fx, fy, fz


@inline
def raw_density(density, widths, x):
    """Return exp(shift + interpolated value) at one warped point."""
    table, links = density.table, density.layout
    i, fx = cell(x[0], np.int64(links[0]))
    j, fy = cell(x[1], np.int64(links[1]))
    k, fz = cell(x[2], np.int64(links[2]))
    total = density.shift
    for corner in range(8):
        di, dj, dk = corner >> 2, (corner >> 1) & 1, corner & 1
        w = (fx if di else np.float32(1) - fx) * (fy if dj else np.float32(1) - fy)
        total += w * (fz if dk else np.float32(1) - fz) * table[row_of(links, i + di, j + dj, k + dk)]
    return np.float32(math.exp(min(max(total, EXPONENT_MIN), EXPONENT_MAX)))


@parallel_kernel
def density_at(density, widths, x, threads, sigma):
    """sigma [n] = raw density at warped points x [n, 3]."""
    n = len(x)
    for thread in prange(threads):
        for p in range(thread * n // threads, (thread + 1) * n // threads):
            sigma[p] = raw_density(density, widths, x[p])


@parallel_kernel
def march_density(density, widths, rays, space, occupancy, displacement, settings, threads, samples):
    """March rays through a voxel density; see march.march_partition and vm.march_density."""
    for thread in prange(threads):
        march_partition(
            raw_density, no_prefetch, density, widths, rays, space, occupancy, displacement, settings, thread, threads,
            samples,
        )  # fmt: skip


@parallel_kernel
def density_backward(density, widths, samples, sigma_gradients, to):
    """Add dL/d(table) and, after the table's last element, dL/d(shift) to the thread's buffer to[thread]."""
    links = density.layout
    starts, ends, x, sigma = samples.starts, samples.ends, samples.x, samples.sigma
    n = len(ends)
    threads, stride = to.shape
    flat = to.reshape(-1)
    for thread in prange(threads):
        shift_gradient = _ZERO
        offsets, g = np.empty(8, np.int64), np.empty(1, np.float32)
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            for k in range(starts[r], ends[r]):
                g[0] = sigma_gradients[k] * sigma[k]  # exp'(e) = exp(e), even beyond the clamp, or e could not return
                if g[0] != _ZERO:
                    shift_gradient += g[0]
                    fx, fy, fz = corners(links, x[k], np.int64(1), offsets)
                    voxel_row_backward(flat, np.int64(thread * stride), offsets, fx, fy, fz, g, np.int64(0), widths)
        to[thread, :64] = 0  # block 0, shared by all unallocated blocks, never learns
        to[thread, stride - 1] += shift_gradient


@parallel_kernel
def density_position_gradient(density, widths, samples, sigma_gradients, threads, position_gradients):
    """Add dL/dx to position_gradients [n, 3]; the slope is that of the cell that contains the sample."""
    table, links = density.table, density.layout
    starts, ends, x, sigma = samples.starts, samples.ends, samples.x, samples.sigma
    n = len(ends)
    for thread in prange(threads):
        offsets, g, slopes = np.empty(8, np.int64), np.empty(1, np.float32), np.empty(3, np.float32)
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            for k in range(starts[r], ends[r]):
                g[0] = sigma_gradients[k] * sigma[k]
                if g[0] != _ZERO:
                    fx, fy, fz = corners(links, x[k], np.int64(1), offsets)
                    voxel_row_slopes(table, offsets, fx, fy, fz, g, np.int64(0), slopes, widths)
                    for a in range(3):
                        position_gradients[k, a] += slopes[a] * np.float32(links[a] - 1)


# -- rows as features of selected samples -----------------------------------------------------------------------------


@parallel_kernel
def features(table, links, widths, x, index, threads, out):
    """out [m, width]: rows interpolated at samples x[index[i]]."""
    n, width = out.shape
    flat = out.reshape(-1)
    for thread in prange(threads):
        offsets = np.empty(8, np.int64)
        for i in range(thread * n // threads, (thread + 1) * n // threads):
            fx, fy, fz = corners(links, x[index[i]], width, offsets)
            voxel_row(table, offsets, fx, fy, fz, flat, np.int64(i * width), widths)


@parallel_kernel
def features_backward(table, links, widths, x, index, gradients, threads, to):
    """Add dL/d(table) to the thread's buffer to[thread]; gradients [m, width] = dL/d(out)."""
    n, width = gradients.shape
    stride = to.shape[1]
    buffers, flat = to.reshape(-1), gradients.reshape(-1)
    for thread in prange(threads):
        offsets = np.empty(8, np.int64)
        base = np.int64(thread * stride)
        for i in range(thread * n // threads, (thread + 1) * n // threads):
            fx, fy, fz = corners(links, x[index[i]], width, offsets)
            voxel_row_backward(buffers, base, offsets, fx, fy, fz, flat, np.int64(i * width), widths)
        to[thread, : 64 * width] = 0  # as above


@parallel_kernel
def features_position_gradient(table, links, widths, x, index, gradients, threads, position_gradients):
    """Add dL/dx of the selected samples to position_gradients [n, 3]."""
    n, width = gradients.shape
    flat = gradients.reshape(-1)
    for thread in prange(threads):
        offsets, slopes = np.empty(8, np.int64), np.empty(3, np.float32)
        for i in range(thread * n // threads, (thread + 1) * n // threads):
            k = index[i]
            fx, fy, fz = corners(links, x[k], width, offsets)
            voxel_row_slopes(table, offsets, fx, fy, fz, flat, np.int64(i * width), slopes, widths)
            for a in range(3):
                position_gradients[k, a] += slopes[a] * np.float32(links[a] - 1)


@parallel_kernel
def smoothness_backward(table, links, width, strength, to):
    """Add strength * d/dt of half the sum of squared differences between neighboring allocated vertices."""
    size = links[:3].astype(np.int64)
    # A vertex writes only its own gradient, so threads share one buffer without races.
    for i in prange(size[0]):
        for j in range(size[1]):
            for k in range(size[2]):
                here = row_of(links, i, j, k)
                if here < 64:  # block 0 never learns
                    continue
                for axis in range(3):
                    for way in (-1, 1):
                        u = i + (way if axis == 0 else 0)
                        v = j + (way if axis == 1 else 0)
                        w = k + (way if axis == 2 else 0)
                        if u < 0 or v < 0 or w < 0 or u >= size[0] or v >= size[1] or w >= size[2]:
                            continue
                        there = row_of(links, u, v, w)
                        if there >= 64:
                            for f in range(width):
                                to[here * width + f] += strength * (table[here * width + f] - table[there * width + f])
