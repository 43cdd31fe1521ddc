"""A multi-resolution hash grid with its levels concatenated (Mueller et al. 2022, section 3).

The grid is that of hash_color.py: every vertex of a level carries four floats. There the levels are summed to a color;
here the interpolated values of level l fill columns 4 l to 4 l + 3, for a network to read.
"""

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import parallel_kernel
from stylerf.kernels.cpu.simd_hash import hash_rows, hash_rows_backward


@parallel_kernel
def encode(table, layout, levels, x, threads, out):
    """out [n, 4 levels] of points x [n, 3] in 0..1.

    layout: int32 [6, levels], see simd_hash.py. levels: a tuple as long as there are levels (a compile-time constant).
    """
    n, width = out.shape
    flat = out.reshape(-1)
    for thread in prange(threads):
        for k in range(thread * n // threads, (thread + 1) * n // threads):
            hash_rows(table, layout, x[k, 0], x[k, 1], x[k, 2], flat, np.int64(k * width), levels)


@parallel_kernel
def encode_backward(layout, levels, x, gradients, threads, to):
    """Add dL/d(table) to the thread's buffer to[thread]; gradients [n, 4 levels] = dL/d(out)."""
    n, width = gradients.shape
    stride = to.shape[1]
    buffers, flat = to.reshape(-1), gradients.reshape(-1)
    for thread in prange(threads):
        base = np.int64(thread * stride)
        for k in range(thread * n // threads, (thread + 1) * n // threads):
            place = np.int64(k * width)
            hash_rows_backward(buffers, base, layout, x[k, 0], x[k, 1], x[k, 2], flat, place, levels)
