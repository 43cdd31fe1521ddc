"""Products of planes and lines as features of chosen samples, for a color head; tables are laid out as in vm.py."""

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import parallel_kernel
from stylerf.kernels.cpu.simd_vm import vm_features, vm_features_backward, vm_features_slopes
from stylerf.kernels.cpu.vm import place


@parallel_kernel
def features(table, size, ranks, x, index, threads, out):
    """out [m, 3 rank] of samples x[index[i]] in 0..1."""
    n, width = out.shape
    rank = np.int64(len(ranks))
    flat = out.reshape(-1)
    for thread in prange(threads):
        for i in range(thread * n // threads, (thread + 1) * n // threads):
            for m in range(3):
                first, second, line, fu, fv, fw = place(m, x[index[i]], size, rank)
                vm_features(table, first, second, line, fu, fv, fw, flat, np.int64(i * width + m * rank), ranks)


@parallel_kernel
def features_backward(table, size, ranks, x, index, gradients, threads, to):
    """Add dL/d(table) to the thread's buffer to[thread]; gradients [m, 3 rank] = dL/d(out)."""
    n, width = gradients.shape
    rank, stride = np.int64(len(ranks)), to.shape[1]
    buffers, flat = to.reshape(-1), gradients.reshape(-1)
    for thread in prange(threads):
        base = np.int64(thread * stride)
        for i in range(thread * n // threads, (thread + 1) * n // threads):
            for m in range(3):
                first, second, line, fu, fv, fw = place(m, x[index[i]], size, rank)
                here = np.int64(i * width + m * rank)
                vm_features_backward(table, first, second, line, fu, fv, fw, flat, here, buffers, base, ranks)


@parallel_kernel
def features_position_gradient(table, size, ranks, x, index, gradients, threads, position_gradients):
    """Add dL/dx of the chosen samples to position_gradients [n, 3]."""
    n, width = gradients.shape
    rank = np.int64(len(ranks))
    flat = gradients.reshape(-1)
    for thread in prange(threads):
        slopes = np.empty(3, np.float32)
        for i in range(thread * n // threads, (thread + 1) * n // threads):
            k = index[i]
            for m in range(3):
                first, second, line, fu, fv, fw = place(m, x[k], size, rank)
                here = np.int64(i * width + m * rank)
                vm_features_slopes(table, first, second, line, fu, fv, fw, flat, here, slopes, ranks)
                for axis in range(3):
                    along = (m + 1 + axis) % 3
                    position_gradients[k, along] += slopes[axis] * np.float32(size[along] - 1)
