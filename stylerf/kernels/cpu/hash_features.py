"""encode, hash: the levels of a multi-resolution hash grid side by side, as features of chosen samples for a head."""

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import parallel_kernel
from stylerf.kernels.cpu.simd_hash import hash_rows, hash_rows_backward, hash_rows_slopes


@parallel_kernel
def features(table, layout, levels, x, index, chunks, out):
    """out [m, 4 levels] of samples x[index[i]] in 0..1; layout, levels: see vector_hash."""
    n, width = out.shape
    flat = out.reshape(-1)
    for c in prange(chunks):
        for i in range(c * n // chunks, (c + 1) * n // chunks):
            k = index[i]
            hash_rows(table, layout, x[k, 0], x[k, 1], x[k, 2], flat, np.int64(i * width), levels)


@parallel_kernel
def features_backward(layout, levels, x, index, gradients, chunks, to):
    """Add dL/d(table) to the chunk's buffer to[chunk]; gradients [m, 4 levels] = dL/d(out)."""
    n, width = gradients.shape
    stride = to.shape[1]
    buffers, flat = to.reshape(-1), gradients.reshape(-1)
    for c in prange(chunks):
        base = np.int64(c * stride)
        for i in range(c * n // chunks, (c + 1) * n // chunks):
            k = index[i]
            hash_rows_backward(buffers, base, layout, x[k, 0], x[k, 1], x[k, 2], flat, np.int64(i * width), levels)


@parallel_kernel
def features_position_gradient(table, layout, levels, x, index, gradients, chunks, position_gradients):
    """Add dL/dx of the chosen samples to position_gradients [n, 3]."""
    n, width = gradients.shape
    flat, out = gradients.reshape(-1), position_gradients.reshape(-1)
    for c in prange(chunks):
        for i in range(c * n // chunks, (c + 1) * n // chunks):
            k = index[i]
            hash_rows_slopes(
                table, layout, x[k, 0], x[k, 1], x[k, 2], flat, np.int64(i * width), out, np.int64(k * 3), levels
            )
