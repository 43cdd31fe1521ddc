"""The concatenated levels of a multi-resolution hash grid as features of chosen samples, for a color head."""

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import parallel_kernel
from stylerf.kernels.cpu.simd_hash import hash_rows, hash_rows_backward, hash_rows_slopes


@parallel_kernel
def features(table, layout, levels, x, index, threads, out):
    """out [m, 4 levels] of samples x[index[i]] in 0..1; layout, levels: see simd_hash.py."""
    n, width = out.shape
    flat = out.reshape(-1)
    for thread in prange(threads):
        for i in range(thread * n // threads, (thread + 1) * n // threads):
            k = index[i]
            hash_rows(table, layout, x[k, 0], x[k, 1], x[k, 2], flat, np.int64(i * width), levels)


@parallel_kernel
def features_backward(layout, levels, x, index, gradients, threads, to):
    """Add dL/d(table) to the thread's buffer to[thread]; gradients [m, 4 levels] = dL/d(out)."""
    n, width = gradients.shape
    stride = to.shape[1]
    buffers, flat = to.reshape(-1), gradients.reshape(-1)
    for thread in prange(threads):
        base = np.int64(thread * stride)
        for i in range(thread * n // threads, (thread + 1) * n // threads):
            k = index[i]
            hash_rows_backward(buffers, base, layout, x[k, 0], x[k, 1], x[k, 2], flat, np.int64(i * width), levels)


@parallel_kernel
def features_position_gradient(table, layout, levels, x, index, gradients, threads, position_gradients):
    """Add dL/dx of the chosen samples to position_gradients [n, 3]."""
    n, width = gradients.shape
    flat, out = gradients.reshape(-1), position_gradients.reshape(-1)
    for thread in prange(threads):
        for i in range(thread * n // threads, (thread + 1) * n // threads):
            k = index[i]
            hash_rows_slopes(
                table, layout, x[k, 0], x[k, 1], x[k, 2], flat, np.int64(i * width), out, np.int64(k * 3), levels
            )
