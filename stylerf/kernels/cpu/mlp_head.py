"""A color head of one hidden layer: sigmoid(W2 relu(W1 (phi, Y) + b1) + b2), packed samples as in color_heads.py.

numbers, flat: W1 of the features [f, h], W1 of the harmonics [bands, h], b1 [h], W2 [3, h], b2 [3]. h is a compile-time
constant, the length of the tuple `hidden`, so that a row of h floats is one vector. The direction's contribution to the
hidden layer is computed once per ray.
"""

import numpy as np
from numba import prange

from stylerf.kernels.cpu.color_heads import sigmoid
from stylerf.kernels.cpu.compiling import inline, parallel_kernel
from stylerf.kernels.cpu.simd_vm import axpy_row, dot_rows

_ONE, _ZERO = np.float32(1), np.float32(0)


@inline
def from_direction(numbers, at, basis, r, hidden, out):
    """out = b1 + sum_b Y_b W1_b; at: where the harmonics' rows begin."""
    h, bands = len(out), basis.shape[1]
    for u in range(h):
        out[u] = numbers[at + bands * h + u]
    for b in range(bands):
        axpy_row(basis[r, b], numbers, np.int64(at + b * h), out, np.int64(0), hidden)


@inline
def hidden_layer(numbers, phi, i, seen, hidden, out):
    """out = relu(seen + W1 phi_i)."""
    width = phi.shape[1]
    for u in range(len(out)):
        out[u] = seen[u]
    for f in range(width):
        axpy_row(phi[i, f], numbers, np.int64(f * len(out)), out, np.int64(0), hidden)
    for u in range(len(out)):
        out[u] = max(out[u], _ZERO)


@parallel_kernel
def mlp(phi, hidden, numbers, basis, index, ray, threads, out):
    """out[index[i]] = the color of sample i."""
    m, width = phi.shape
    h, bands = np.int64(len(hidden)), basis.shape[1]
    second = (width + bands + 1) * h
    for thread in prange(threads):
        seen, layer = np.empty(h, np.float32), np.empty(h, np.float32)
        last = np.int64(-1)
        for i in range(thread * m // threads, (thread + 1) * m // threads):
            if ray[i] != last:
                last = ray[i]
                from_direction(numbers, width * h, basis, last, hidden, seen)
            hidden_layer(numbers, phi, i, seen, hidden, layer)
            for j in range(3):
                z = numbers[second + 3 * h + j]
                out[index[i], j] = sigmoid(z + dot_rows(numbers, np.int64(second + j * h), layer, np.int64(0), hidden))


@inline
def _add_direction_gradient(learned, basis, r, buffers, at, hidden):
    """Add the gradient from one ray's samples to W1 of the harmonics and b1, at `at`."""
    h, bands = len(learned), basis.shape[1]
    for b in range(bands):
        axpy_row(basis[r, b], learned, np.int64(0), buffers, np.int64(at + b * h), hidden)
    axpy_row(_ONE, learned, np.int64(0), buffers, np.int64(at + bands * h), hidden)


@parallel_kernel
def mlp_backward(phi, hidden, numbers, basis, index, ray, colors, color_gradients, threads, phi_gradients, at, to):
    """phi_gradients [m, f] = dL/d(phi), and dL/d(numbers) added to to[thread, at:]."""
    m, width = phi.shape
    h, bands, stride = np.int64(len(hidden)), basis.shape[1], to.shape[1]
    second = (width + bands + 1) * h
    buffers = to.reshape(-1)
    for thread in prange(threads):
        base = np.int64(thread * stride + at)
        seen, layer, learned = np.empty(h, np.float32), np.empty(h, np.float32), np.zeros(h, np.float32)
        back = np.empty(h, np.float32)
        last = np.int64(-1)
        for i in range(thread * m // threads, (thread + 1) * m // threads):
            if ray[i] != last:
                if last >= 0:
                    _add_direction_gradient(learned, basis, last, buffers, base + width * h, hidden)
                    learned[:] = _ZERO
                last = ray[i]
                from_direction(numbers, width * h, basis, last, hidden, seen)
            hidden_layer(numbers, phi, i, seen, hidden, layer)
            k = index[i]
            back[:] = _ZERO
            for j in range(3):
                g = color_gradients[k, j] * colors[k, j] * (_ONE - colors[k, j])
                buffers[base + second + 3 * h + j] += g
                axpy_row(g, layer, np.int64(0), buffers, np.int64(base + second + j * h), hidden)
                axpy_row(g, numbers, np.int64(second + j * h), back, np.int64(0), hidden)
            for u in range(h):
                if layer[u] <= _ZERO:
                    back[u] = _ZERO
                learned[u] += back[u]
            for f in range(width):
                phi_gradients[i, f] = dot_rows(numbers, np.int64(f * h), back, np.int64(0), hidden)
                axpy_row(phi[i, f], back, np.int64(0), buffers, np.int64(base + f * h), hidden)
        if last >= 0:
            _add_direction_gradient(learned, basis, last, buffers, base + width * h, hidden)
