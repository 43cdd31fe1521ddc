"""A region's own colors, whose logits are added to those of the field: which points, and where in the region's box."""

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import inline, parallel_kernel
from stylerf.kernels.cpu.regions import cell_of

_ONE, _ZERO = np.float32(1), np.float32(0)


@inline
def _into_box(x, k, low, scale, own_x):
    """Position k in the box, 0..1."""
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
    """out = sigmoid(logit(out) + logit(own)) where both are colors (channel 0 >= 0): odds multiply."""
    n = len(ends)
    for thread in prange(threads):
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            for k in range(starts[r], ends[r]):
                if own[k, 0] >= _ZERO and out[k, 0] >= _ZERO:
                    for j in range(3):
                        # Clamped, since nothing could move a logit of infinity: white and black can be repainted too.
                        base = min(max(out[k, j], np.float32(1e-4)), np.float32(1 - 1e-4))
                        both = base * own[k, j]
                        out[k, j] = both / (both + (_ONE - base) * (_ONE - own[k, j]))


@parallel_kernel
def restrict_colored(marked, cells, low, scale, points, colors, threads, own_x, inside):
    """own_x as in restrict, inside = colors for points in marked cells; elsewhere -1 in the first channel."""
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
