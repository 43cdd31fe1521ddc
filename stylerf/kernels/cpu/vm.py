"""encode, vm: vector-matrix fields (TensoRF, Chen et al. 2022, eq. 7) as density and as spherical-harmonic color.

A table is one flat float32 array: for m = 0, 1, 2 a plane [size[a], size[b], rank] over axes a = (m+1)%3, b = (m+2)%3,
then for m = 0, 1, 2 a line [size[m], rank] over axis m. A sample's feature m, r is bilinear(plane m, r) * linear(line
m, r). Raw density is exp(shift + sum of all features), the exponent clamped to [-15, 12].
"""

import math

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import inline, parallel_kernel
from stylerf.kernels.cpu.march import EXPONENT_MAX, EXPONENT_MIN, cell, end_of_chunk, walk_chunk
from stylerf.kernels.cpu.simd_vm import (
    add_roughness,
    axpy_row,
    vm_dot_backward,
    vm_prefetch,
    vm_projected,
    vm_projected_backward,
    vm_sum,
)

_ONE, _ZERO = np.float32(1), np.float32(0)


@inline
def place(m, x, size, rank):
    """Row offsets in the table and cell positions of point x for plane m."""
    a, b = (m + 1) % 3, (m + 2) % 3
    iu, fu = cell(x[a], size[a])
    iv, fv = cell(x[b], size[b])
    iw, fw = cell(x[m], size[m])
    # Planes lie one after another, then the lines.
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
    """place() of all three planes."""
    return place(0, x, size, rank), place(1, x, size, rank), place(2, x, size, rank)


@inline
def raw_density(table, size, shift, ranks, x):
    """exp(shift + features) of one warped point."""
    total = shift + vm_sum(table, *places(x, size, np.int64(len(ranks))), ranks)
    return np.float32(math.exp(min(max(total, EXPONENT_MIN), EXPONENT_MAX)))


@inline
def fetch(table, size, shift, ranks, x):
    """Ask for the rows of one warped point."""
    vm_prefetch(table, np.int64(0), *places(x, size, np.int64(len(ranks))), ranks)


@parallel_kernel
def density(table, size, shift, ranks, x, chunks, sigma):
    """Raw density of warped points x [n, 3]."""
    n = len(x)
    for c in prange(chunks):
        for p in range(c * n // chunks, (c + 1) * n // chunks):
            sigma[p] = raw_density(table, size, shift, ranks, x[p])


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
    size,
    shift,
    ranks,
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
    """Walk rays through a vm density: see march.walk_chunk."""
    for c in prange(chunks):
        walk_chunk(
            raw_density,
            fetch,
            table,
            size,
            shift,
            ranks,
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
def density_backward(table, size, shift, ranks, x, starts, ends, sigma, sigma_gradients, chunks, to):
    """Add dL/d(table) and, behind the table's last element, dL/d(shift) to the chunk's own buffer to[chunk]."""
    n = len(ends)
    stride = to.shape[1]
    flat = to.reshape(-1)
    for c in prange(chunks):
        stop = end_of_chunk(ends, c, chunks)
        shift_gradient = _ZERO
        for r in range(c * n // chunks, (c + 1) * n // chunks):
            for k in range(starts[r], ends[r]):
                g = sigma_gradients[k] * sigma[k]  # d exp(e)/de = exp(e)
                if g != _ZERO:
                    shift_gradient += g
                    if k + 1 < stop:
                        following = places(x[k + 1], size, np.int64(len(ranks)))
                        vm_prefetch(table, np.int64(0), *following, ranks)
                        vm_prefetch(flat, np.int64(c * stride), *following, ranks)
                    for m in range(3):
                        first, second, line, fu, fv, fw = place(m, x[k], size, np.int64(len(ranks)))
                        vm_dot_backward(table, first, second, line, fu, fv, fw, g, flat, np.int64(c * stride), ranks)
        to[c, stride - 1] += shift_gradient


@inline
def head_of_ray(head, basis, r, bands, features, out):
    """out[j, f] = sum_b head[j, b, f] basis[r, b]: the color head seen from one ray's direction."""
    for j in range(3):
        for f in range(features):
            out[j * features + f] = _ZERO
        for b in range(bands):
            w = basis[r, b]
            for f in range(features):
                out[j * features + f] += head[(j * bands + b) * features + f] * w


@parallel_kernel
def color(table, size, ranks, head, bias, basis, x, starts, ends, weights, least, chunks, out):
    """Colors of samples with weight > `least`: sigmoid(sum_b basis_b (head_b . features) + bias); else -1.

    head: flat [3, bands, 3 rank]; bias [3]; basis [rays, bands]: spherical harmonics of the ray directions.
    """
    n = len(ends)
    bands = basis.shape[1]
    rank = np.int64(len(ranks))
    width = 3 * rank
    for c in prange(chunks):
        ray_head = np.empty(3 * width, np.float32)
        z = np.empty(3, np.float32)
        stop = end_of_chunk(ends, c, chunks)
        for r in range(c * n // chunks, (c + 1) * n // chunks):
            ready = False
            for k in range(starts[r], ends[r]):
                if weights[k] <= least:
                    out[k, 0] = -_ONE
                    continue
                if k + 1 < stop and weights[k + 1] > least:
                    vm_prefetch(table, np.int64(0), *places(x[k + 1], size, rank), ranks)
                if not ready:
                    head_of_ray(head, basis, r, bands, width, ray_head)
                    ready = True
                vm_projected(table, *places(x[k], size, rank), ray_head, z, ranks)
                for j in range(3):
                    out[k, j] = _ONE / (_ONE + np.float32(math.exp(-(bias[j] + z[j]))))


@parallel_kernel
def color_backward(table, size, ranks, head, basis, x, starts, ends, colors, color_gradients, chunks, to):
    """Add dL/d(table), then dL/d(head), then dL/d(bias) to the chunk's buffer to[chunk] of that layout.

    colors, color_gradients [n, 3]: the forward's result and dL/dc; samples with colors[k, 0] < 0 are skipped.
    """
    n = len(ends)
    bands = basis.shape[1]
    rank = np.int64(len(ranks))
    width = 3 * rank
    stride = to.shape[1]
    flat = to.reshape(-1)
    head_at = stride - 3 - 3 * bands * width
    for c in prange(chunks):
        base = np.int64(c * stride)
        ray_head = np.empty(3 * width, np.float32)
        ray_head_gradient = np.empty(3 * width, np.float32)
        g = np.empty(3, np.float32)
        stop = end_of_chunk(ends, c, chunks)
        for r in range(c * n // chunks, (c + 1) * n // chunks):
            ready = False
            for k in range(starts[r], ends[r]):
                if colors[k, 0] < _ZERO:
                    continue
                if k + 1 < stop and colors[k + 1, 0] >= _ZERO:
                    following = places(x[k + 1], size, rank)
                    vm_prefetch(table, np.int64(0), *following, ranks)
                    vm_prefetch(flat, base, *following, ranks)
                if not ready:
                    head_of_ray(head, basis, r, bands, width, ray_head)
                    ray_head_gradient[:] = _ZERO
                    ready = True
                for j in range(3):
                    g[j] = color_gradients[k, j] * colors[k, j] * (_ONE - colors[k, j])
                    to[c, stride - 3 + j] += g[j]
                where = places(x[k], size, rank)
                vm_projected_backward(table, *where, ray_head, g[0], g[1], g[2], ray_head_gradient, flat, base, ranks)
            if ready:
                for j in range(3):
                    for b in range(bands):
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
def smoothness_backward(table, size, ranks, strength, to):
    """Add strength * d/dt of half the summed squared differences between neighboring plane texels to to[...]."""
    rank = np.int64(len(ranks))
    at = np.int64(0)
    for m in range(3):
        rows, columns = size[(m + 1) % 3], size[(m + 2) % 3]
        across = columns * rank
        for i in prange(rows):
            for j in range(columns):
                here = at + (i * columns + j) * rank
                # Past an edge lies the texel itself, from which it does not differ.
                above = here - across if i > 0 else here
                below = here + across if i < rows - 1 else here
                left = here - rank if j > 0 else here
                right = here + rank if j < columns - 1 else here
                add_roughness(table, here, above, below, left, right, strength, to, ranks)
        at += rows * across
