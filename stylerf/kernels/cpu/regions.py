"""The part of each ray that lies in a region: a grid of marked cells over the cube."""

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import inline, parallel_kernel

_ZERO = np.float32(0)


@inline
def cell_of(x, k, cells):
    """Return the row-major index of the cell that point k lies in; points outside the cube count to its border."""
    number = np.int64(0)
    for a in range(3):
        i = np.int64(x[k, a] * np.float32(cells))
        number = number * cells + min(max(i, np.int64(0)), np.int64(cells - 1))
    return number


@parallel_kernel
def weights_inside(marked, cells, points, threads, out):
    """out[r] = sum of the ray's weights over points whose cell is marked; marked: [cells^3] bool."""
    starts, ends, x, weights = points
    n = len(ends)
    for thread in prange(threads):
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            total = _ZERO
            for k in range(starts[r], ends[r]):
                if weights[k] > _ZERO and marked[cell_of(x, k, cells)]:
                    total += weights[k]
            out[r] = total


@parallel_kernel
def add_to_cells(values, cells, points, to):
    """Add w (values[r], 1) of every point of ray r to to[its cell]; values: [rays, m], to: [cells^3, m + 1]."""
    starts, ends, x, weights = points
    m = values.shape[1]
    for _ in prange(1):  # serial: rays share cells
        for r in range(len(ends)):
            for k in range(starts[r], ends[r]):
                w = weights[k]
                if w > _ZERO:
                    cell = cell_of(x, k, cells)
                    for i in range(m):
                        to[cell, i] += w * values[r, i]
                    to[cell, m] += w


@parallel_kernel
def ends_inside(marked, cells, points, t, threads, out):
    """out[r] = (sum w, then sums over marked cells of w, w t and w x), [rays, 6]: where a ray ends in the region."""
    starts, ends, x, weights = points
    n = len(ends)
    for thread in prange(threads):
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            for i in range(6):
                out[r, i] = _ZERO
            for k in range(starts[r], ends[r]):
                w = weights[k]
                if w <= _ZERO:
                    continue
                out[r, 0] += w
                if marked[cell_of(x, k, cells)]:
                    out[r, 1] += w
                    out[r, 2] += w * t[k]
                    for a in range(3):
                        out[r, 3 + a] += w * x[k, a]


@parallel_kernel
def zero_outside(marked, cells, samples, threads, values):
    """Set values[k] = 0 for samples whose cell is not marked; marked: [cells^3] bool."""
    starts, ends, x = samples.starts, samples.ends, samples.x
    n = len(ends)
    for thread in prange(threads):
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            for k in range(starts[r], ends[r]):
                if not marked[cell_of(x, k, cells)]:
                    values[k] = _ZERO
