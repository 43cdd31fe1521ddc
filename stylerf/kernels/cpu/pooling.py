"""2x2 max pooling of feature maps with stride 2."""

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import inline, parallel_kernel


@parallel_kernel
def max_pool(features: np.ndarray, pooled: np.ndarray) -> None:
    """Write the maximum of each 2x2 square of features [n, h, w] to pooled [n, h', w'].

    h' and w' are h / 2 and w / 2, rounded down (an odd last row or column is dropped) or up (it forms its own squares).
    """
    for i in prange(len(features)):
        _pool_map(features[i], pooled[i])


@parallel_kernel
def max_pool_gradient(features: np.ndarray, pooled: np.ndarray, gradient: np.ndarray, out: np.ndarray) -> None:
    """Write the gradient of max_pool to out [n, h, w], zero where the pooling dropped rows or columns.

    Every element that equals its square's maximum receives the full gradient. Ties are squares of zeros, for which the
    preceding ReLU discards the gradient; others do not occur in practice.
    """
    for i in prange(len(features)):
        _gradient_of_map(features[i], pooled[i], gradient[i], out[i])


# Separate functions per map: numba (0.68) drops assignments to elements of row views created in the body of a prange.


@inline
def _pool_map(features, pooled):
    height, width = features.shape
    whole = width // 2  # squares entirely inside the map: their loop needs no bounds checks and is vectorized
    for y in range(pooled.shape[0]):
        upper, lower, out = features[2 * y], features[min(2 * y + 1, height - 1)], pooled[y]
        for x in range(whole):
            out[x] = max(upper[2 * x], upper[2 * x + 1], lower[2 * x], lower[2 * x + 1])
        if pooled.shape[1] > whole:
            out[whole] = max(upper[width - 1], lower[width - 1])


@inline
def _gradient_of_map(features, pooled, gradient, out):
    height, width = features.shape
    rows, whole = min(height, 2 * pooled.shape[0]), width // 2
    out[rows:] = np.float32(0.0)
    for y in range(rows):
        line, best, value, written = features[y], pooled[y // 2], gradient[y // 2], out[y]
        for x in range(whole):
            written[2 * x] = value[x] if line[2 * x] == best[x] else np.float32(0.0)
            written[2 * x + 1] = value[x] if line[2 * x + 1] == best[x] else np.float32(0.0)
        if width % 2 == 1:
            inside = pooled.shape[1] > whole and line[width - 1] == best[whole]
            written[width - 1] = value[whole] if inside else np.float32(0.0)
