"""What of a ray lies in a region: a grid of marked cells over the cube."""

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import inline, parallel_kernel

_ZERO = np.float32(0)


@inline
def cell_of(x, k, cells):
    """Row-major number of the cell that point k lies in; what lies outside the cube counts to its border."""
    number = np.int64(0)
    for a in range(3):
        i = np.int64(x[k, a] * np.float32(cells))
        number = number * cells + min(max(i, np.int64(0)), np.int64(cells - 1))
    return number


@parallel_kernel
def weights_inside(marked, cells, x, weights, starts, ends, chunks, out):
    """out[r] = sum of the ray's weights over samples whose cell is marked; marked: [cells^3] bool."""
    n = len(ends)
    for c in prange(chunks):
        for r in range(c * n // chunks, (c + 1) * n // chunks):
            total = _ZERO
            for k in range(starts[r], ends[r]):
                if weights[k] > _ZERO and marked[cell_of(x, k, cells)]:
                    total += weights[k]
            out[r] = total


@parallel_kernel
def add_to_cells(values, cells, x, weights, starts, ends, to):
    """Add sum w (values[r], 1) of ray r's samples to to[its cell]; values: [rays, m], to: [cells^3, m + 1]."""
    m = values.shape[1]
    for _ in prange(1):  # one after another: rays share cells
        for r in range(len(ends)):
            for k in range(starts[r], ends[r]):
                w = weights[k]
                if w > _ZERO:
                    cell = cell_of(x, k, cells)
                    for i in range(m):
                        to[cell, i] += w * values[r, i]
                    to[cell, m] += w


@parallel_kernel
def ends_inside(marked, cells, x, t, weights, starts, ends, chunks, out):
    """out[r] = (sum w, sum over marked cells of w, of w t, of w x): [rays, 6]. What a ray's end in the region is."""
    n = len(ends)
    for c in prange(chunks):
        for r in range(c * n // chunks, (c + 1) * n // chunks):
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
def keep_inside(marked, cells, x, starts, ends, chunks, values):
    """values[k] = 0 for samples whose cell is not marked; marked: [cells^3] bool."""
    n = len(ends)
    for c in prange(chunks):
        for r in range(c * n // chunks, (c + 1) * n // chunks):
            for k in range(starts[r], ends[r]):
                if not marked[cell_of(x, k, cells)]:
                    values[k] = _ZERO
