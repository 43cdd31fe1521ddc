"""Adam (Kingma & Ba 2015) over flat tables: adds the chunks' buffers in order, updates, clears, in one pass."""

import math

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import parallel_kernel

_ONE, _ZERO = np.float32(1), np.float32(0)


@parallel_kernel
def adam(values, gradients, first, second, rate, beta1, beta2, epsilon, correction1, correction2, begin, end, blocks):
    """One Adam step on values[begin:end]; gradients [chunks, n] are summed and set to zero.

    correction1 = 1 - beta1^t, correction2 = 1 - beta2^t. Runs of eight elements without any gradient are left as they
    are, moments too (as torch.optim.SparseAdam): most of a table lies where no ray of the batch has been.
    """
    chunks = gradients.shape[0]
    runs = (end - begin + 7) // 8
    for b in prange(blocks):
        for run in range(b * runs // blocks, (b + 1) * runs // blocks):
            low = begin + run * 8
            high = min(low + 8, end)
            touched = _ZERO
            for c in range(chunks):
                for i in range(low, high):
                    touched += abs(gradients[c, i])
            if touched == _ZERO:
                continue
            for i in range(low, high):
                g = gradients[0, i]
                gradients[0, i] = _ZERO
                for c in range(1, chunks):
                    g += gradients[c, i]
                    gradients[c, i] = _ZERO
                m = beta1 * first[i] + (_ONE - beta1) * g
                v = beta2 * second[i] + (_ONE - beta2) * g * g
                first[i] = m
                second[i] = v
                values[i] -= rate * (m / correction1) / (np.float32(math.sqrt(v / correction2)) + epsilon)
