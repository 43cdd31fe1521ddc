"""Adam (Kingma & Ba 2015) over flat tables: sums the threads' buffers in order, updates and clears them in one pass."""

import math

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import parallel_kernel
from stylerf.kernels.cpu.simd_adam import LANES, adam_run, any_gradient, gather_gradient

_ONE, _ZERO = np.float32(1), np.float32(0)


@parallel_kernel
def adam(values, gradients, first, second, rate, beta1, beta2, epsilon, correction1, correction2, begin, end, blocks):
    """One Adam step on values[begin:end]; gradients [threads, n] are summed and set to zero.

    correction1 = 1 - beta1^t, correction2 = 1 - beta2^t. Runs of eight elements without any gradient are
    skipped, moments too (as torch.optim.SparseAdam does): a batch of rays touches a small part of a table.
    """
    threads, stride = gradients.shape
    flat = gradients.reshape(-1)
    runs = (end - begin) // LANES
    step, root = rate / correction1, _ONE / np.float32(math.sqrt(correction2))
    for b in prange(blocks):
        for run in range(b * runs // blocks, (b + 1) * runs // blocks):
            at = begin + run * LANES
            touched = any_gradient(flat, at)
            for thread in range(1, threads):
                touched |= any_gradient(flat, thread * stride + at)
            if not touched:
                continue
            for thread in range(1, threads):
                gather_gradient(flat, at, thread * stride + at)
            adam_run(values, flat, first, second, at, at, step, beta1, beta2, epsilon, root)
    rest = begin + runs * LANES
    touched = False
    for i in range(rest, end):
        for thread in range(threads):
            touched |= gradients[thread, i] != _ZERO
    if touched:
        for i in range(rest, end):
            g = gradients[0, i]
            gradients[0, i] = _ZERO
            for thread in range(1, threads):
                g += gradients[thread, i]
                gradients[thread, i] = _ZERO
            first[i] = beta1 * first[i] + (_ONE - beta1) * g
            second[i] = beta2 * second[i] + (_ONE - beta2) * g * g
            values[i] -= step * first[i] / (root * np.float32(math.sqrt(second[i])) + epsilon)
