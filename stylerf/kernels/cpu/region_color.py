"""Colors of marked cells that add their logits to others'. Which samples they are, and where in the cells' box."""

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
def restrict(marked, cells, low, scale, x, weights, starts, ends, chunks, own_x, within):
    """own_x = (x - low) scale, within = weights, of samples in marked cells [cells^3]; elsewhere within = 0."""
    n = len(ends)
    for c in prange(chunks):
        for r in range(c * n // chunks, (c + 1) * n // chunks):
            for k in range(starts[r], ends[r]):
                within[k] = _ZERO
                if weights[k] > _ZERO and marked[cell_of(x, k, cells)]:
                    within[k] = weights[k]
                    _into_box(x, k, low, scale, own_x)


@parallel_kernel
def add_logits(own, starts, ends, chunks, out):
    """out = sigmoid(logit(out) + logit(own)) of samples that both color: odds multiply. own [k, 0] < 0: none."""
    n = len(ends)
    for c in prange(chunks):
        for r in range(c * n // chunks, (c + 1) * n // chunks):
            for k in range(starts[r], ends[r]):
                if own[k, 0] >= _ZERO and out[k, 0] >= _ZERO:
                    for j in range(3):
                        # Odds of 1e-4 at least, both ways: white and black can be repainted too.
                        base = min(max(out[k, j], np.float32(1e-4)), np.float32(1 - 1e-4))
                        both = base * own[k, j]
                        out[k, j] = both / (both + (_ONE - base) * (_ONE - own[k, j]))


@parallel_kernel
def restrict_colored(marked, cells, low, scale, x, colors, starts, ends, chunks, own_x, inside):
    """own_x as in restrict, inside = colors, of samples in marked cells; elsewhere -1 in the first channel."""
    n = len(ends)
    for c in prange(chunks):
        for r in range(c * n // chunks, (c + 1) * n // chunks):
            for k in range(starts[r], ends[r]):
                if colors[k, 0] >= _ZERO and marked[cell_of(x, k, cells)]:
                    _into_box(x, k, low, scale, own_x)
                    for j in range(3):
                        inside[k, j] = colors[k, j]
                else:
                    inside[k, 0] = -_ONE


@parallel_kernel
def add_scaled(found, scale, starts, ends, chunks, out):
    """out += scale found, of what lies on rays."""
    n = len(ends)
    for c in prange(chunks):
        for r in range(c * n // chunks, (c + 1) * n // chunks):
            for k in range(starts[r], ends[r]):
                for a in range(3):
                    out[k, a] += scale * found[k, a]
