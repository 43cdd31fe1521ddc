"""Adam (Kingma & Ba 2015) over flat tables: adds the chunks' gradient buffers in order, updates, clears, in one pass."""

import math

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import parallel_kernel

_ONE, _ZERO = np.float32(1), np.float32(0)


@parallel_kernel
def adam(values, gradients, first, second, rate, beta1, beta2, epsilon, correction1, correction2, begin, end, blocks):
    """One Adam step on values[begin:end]; gradients [chunks, n] are summed and set to zero.

    correction1 = 1 - beta1^t, correction2 = 1 - beta2^t. Elements whose moments and gradient are all zero are left.
    """
    chunks = gradients.shape[0]
    length = end - begin
    for b in prange(blocks):
        for i in range(begin + b * length // blocks, begin + (b + 1) * length // blocks):
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
