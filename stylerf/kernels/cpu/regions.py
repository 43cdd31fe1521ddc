"""Regions (grids of marked cells over the cube): the part of each ray inside, and their own colors on top of others."""

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import inline, parallel_kernel

_ONE, _ZERO = np.float32(1), np.float32(0)
# Lower bound of the base's odds and inverse odds: infinite logits could not be changed, so that even pure black and
# white can be repainted.
MIN_ODDS = np.float32(1e-4)


@inline
def cell_of(x, k, cells):
    """Return the row-major index of the cell that contains point k, clamped to the cube."""
    number = np.int64(0)
    for a in range(3):
        i = np.int64(x[k, a] * np.float32(cells))
        number = number * cells + min(max(i, np.int64(0)), np.int64(cells - 1))
    return number


@parallel_kernel
def weights_inside(marked, cells, points, threads, out):
    """out[r] = sum of the ray's weights over points in marked cells; marked: [cells^3] bool."""
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
    """Add w (values[r], 1) of every point of ray r to to[cell]; values: [rays, m], to: [cells^3, m + 1]."""
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
def mark_cells(samples, cells, min_weight, threads, marked):
    """Set marked[cell] = 1 for the cells of samples with a weight of at least `min_weight`; marked: [cells^3] uint8.

    The opaque background (delta 0) is in no cell. Several threads may mark the same cell, but all write 1.
    """
    starts, ends, x, weights, deltas = samples.starts, samples.ends, samples.x, samples.weights, samples.deltas
    n = len(ends)
    for thread in prange(threads):
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            for k in range(starts[r], ends[r]):
                if weights[k] >= min_weight and deltas[k] > _ZERO:
                    marked[cell_of(x, k, cells)] = np.uint8(1)


@parallel_kernel
def zero_outside(marked, cells, samples, threads, values):
    """Set values[k] = 0 for samples outside marked cells; marked: [cells^3] bool."""
    starts, ends, x = samples.starts, samples.ends, samples.x
    n = len(ends)
    for thread in prange(threads):
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            for k in range(starts[r], ends[r]):
                if not marked[cell_of(x, k, cells)]:
                    values[k] = _ZERO


# -- shares of blended colors ------------------------------------------------------------------------------------------


@parallel_kernel
def fill(value, points, threads, out):
    """out[k] = value for all points on rays."""
    starts, ends = points.starts, points.ends
    n = len(ends)
    for thread in prange(threads):
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            for k in range(starts[r], ends[r]):
                out[k] = value


@parallel_kernel
def weigh_cells(shares, marked, cells, inside, outside, points, threads, out):
    """out[k] = shares[k] times `inside` in marked cells [cells^3] bool, times `outside` elsewhere; works in place."""
    starts, ends, x = points.starts, points.ends, points.x
    n = len(ends)
    for thread in prange(threads):
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            for k in range(starts[r], ends[r]):
                out[k] = shares[k] * (inside if marked[cell_of(x, k, cells)] else outside)


# -- a region's own colors ---------------------------------------------------------------------------------------------


@inline
def _into_box(x, k, low, scale, own_x):
    """own_x = position k in the box, 0..1."""
    for a in range(3):
        own_x[k, a] = min(max((x[k, a] - low[a]) * scale, _ZERO), _ONE)


@parallel_kernel
def restrict(marked, cells, low, scale, points, threads, own_x, own_weights):
    """own_x = (x - low) scale, own_weights = weights in marked cells [cells^3]; elsewhere own_weights = 0."""
    starts, ends, x, weights = points
    n = len(ends)
    for thread in prange(threads):
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            for k in range(starts[r], ends[r]):
                own_weights[k] = _ZERO
                if weights[k] > _ZERO and marked[cell_of(x, k, cells)]:
                    own_weights[k] = weights[k]
                    _into_box(x, k, low, scale, own_x)


@parallel_kernel
def add_logits(own, starts, ends, threads, out):
    """out = sigmoid(logit(out) + logit(own)) where both are colors (channel 0 >= 0): odds are multiplied."""
    n = len(ends)
    for thread in prange(threads):
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            for k in range(starts[r], ends[r]):
                if own[k, 0] >= _ZERO and out[k, 0] >= _ZERO:
                    for j in range(3):
                        base = min(max(out[k, j], MIN_ODDS), _ONE - MIN_ODDS)
                        both = base * own[k, j]
                        # sigmoid(logit(p) + logit(q)) = p q / (p q + (1 - p)(1 - q)), without logarithms.
                        out[k, j] = both / (both + (_ONE - base) * (_ONE - own[k, j]))


@parallel_kernel
def restrict_colored(marked, cells, low, scale, points, colors, threads, own_x, inside):
    """own_x as in restrict(), inside = colors for points in marked cells; elsewhere -1 in the first channel."""
    starts, ends, x = points.starts, points.ends, points.x
    n = len(ends)
    for thread in prange(threads):
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            for k in range(starts[r], ends[r]):
                if colors[k, 0] >= _ZERO and marked[cell_of(x, k, cells)]:
                    _into_box(x, k, low, scale, own_x)
                    for j in range(3):
                        inside[k, j] = colors[k, j]
                else:
                    inside[k, 0] = -_ONE


@parallel_kernel
def add_scaled(found, scale, starts, ends, threads, out):
    """out += scale found, for all samples on rays."""
    n = len(ends)
    for thread in prange(threads):
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            for k in range(starts[r], ends[r]):
                for a in range(3):
                    out[k, a] += scale * found[k, a]
