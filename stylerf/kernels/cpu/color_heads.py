"""Color heads: features of packed samples to view-dependent colors, and the backward passes.

Packed: sample index[i] on ray ray[i], ascending; features phi [m, f]. basis [rays, bands]: spherical harmonics Y of the
rays' directions. `widths`, `hidden`: tuples whose lengths are compile-time constants (see simd_vm.py).
"""

import math

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import inline, parallel_kernel
from stylerf.kernels.cpu.simd_vm import axpy_row, dot_rows

_ONE, _ZERO = np.float32(1), np.float32(0)


@parallel_kernel
def count_marked(marks, bound, starts, ends, threads, counts):
    """counts[r] = number of samples of ray r with marks[k, 0] > bound."""
    n = len(ends)
    for thread in prange(threads):
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            found = 0
            for k in range(starts[r], ends[r]):
                if marks[k, 0] > bound:
                    found += 1
            counts[r] = found


@parallel_kernel
def pack_marked(marks, bound, starts, ends, offsets, threads, index, ray):
    """Pack the samples counted by count_marked; those of ray r are written from offsets[r] on."""
    n = len(ends)
    for thread in prange(threads):
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            at = offsets[r]
            for k in range(starts[r], ends[r]):
                if marks[k, 0] > bound:
                    index[at], ray[at] = k, r
                    at += 1


@parallel_kernel
def hide(starts, ends, threads, out):
    """Set out[k, 0] = -1, the marker for no color, for every sample."""
    n = len(ends)
    for thread in prange(threads):
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            for k in range(starts[r], ends[r]):
                out[k, 0] = -_ONE


@inline
def sigmoid(z):
    return _ONE / (_ONE + np.float32(math.exp(-z)))


# -- linear: features to spherical-harmonic coefficients --------------------------------------------------------------


@inline
def head_of(head, basis, r, width, out):
    """out[j, f] = sum_b head[j, b, f] Y_b: the head for one ray's direction."""
    bands = basis.shape[1]
    for j in range(3):
        for f in range(width):
            out[j * width + f] = _ZERO
        for b in range(bands):
            w = basis[r, b]
            for f in range(width):
                out[j * width + f] += head[(j * bands + b) * width + f] * w


@parallel_kernel
def linear(phi, widths, head, basis, index, ray, threads, out):
    """out[index[i]] = sigmoid(bias + sum_b Y_b head_b . phi_i); head: flat [3, bands, f], then bias [3]."""
    m, width = phi.shape
    flat = phi.reshape(-1)
    bias = len(head) - 3
    for thread in prange(threads):
        seen = np.empty(3 * width, np.float32)
        last = np.int64(-1)
        for i in range(thread * m // threads, (thread + 1) * m // threads):
            # Samples are sorted by ray, so the head is combined with each direction only once.
            if ray[i] != last:
                last = ray[i]
                head_of(head, basis, last, width, seen)
            for j in range(3):
                z = head[bias + j] + dot_rows(seen, np.int64(j * width), flat, np.int64(i * width), widths)
                out[index[i], j] = sigmoid(z)


@inline
def _spread_head(seen_gradient, basis, r, width, flat, at, widths):
    """Add the gradient of one ray's head_of() to the buffer's [3, bands, f] at `at`."""
    bands = basis.shape[1]
    for j in range(3):
        for b in range(bands):
            place = np.int64(at + (j * bands + b) * width)
            axpy_row(basis[r, b], seen_gradient, np.int64(j * width), flat, place, widths)


@parallel_kernel
def linear_backward(phi, widths, head, basis, index, ray, colors, color_gradients, threads, phi_gradients, at, to):
    """phi_gradients [m, f] = dL/d(phi), and dL/d(head, bias) added to to[thread, at:]."""
    m, width = phi.shape
    flat, phi_flat, stride = phi.reshape(-1), phi_gradients.reshape(-1), to.shape[1]
    buffers = to.reshape(-1)
    for thread in prange(threads):
        base = np.int64(thread * stride + at)
        bias = base + len(head) - 3
        seen, seen_gradient = np.empty(3 * width, np.float32), np.zeros(3 * width, np.float32)
        last = np.int64(-1)
        for i in range(thread * m // threads, (thread + 1) * m // threads):
            if ray[i] != last:
                if last >= 0:
                    _spread_head(seen_gradient, basis, last, width, buffers, base, widths)
                    seen_gradient[:] = _ZERO
                last = ray[i]
                head_of(head, basis, last, width, seen)
            k = index[i]
            here = np.int64(i * width)
            for f in range(width):
                phi_flat[here + f] = _ZERO  # not initialized by the caller
            for j in range(3):
                g = color_gradients[k, j] * colors[k, j] * (_ONE - colors[k, j])  # sigmoid' = c (1 - c)
                buffers[bias + j] += g
                axpy_row(g, seen, np.int64(j * width), phi_flat, here, widths)
                axpy_row(g, flat, here, seen_gradient, np.int64(j * width), widths)
        if last >= 0:
            _spread_head(seen_gradient, basis, last, width, buffers, base, widths)


# -- harmonics: features that are spherical-harmonic coefficients -----------------------------------------------------


@parallel_kernel
def harmonic(phi, basis, index, ray, threads, out):
    """out[index[i], j] = sigmoid(sum_b Y_b phi_i[j, b]); phi [m, 3 bands]."""
    m, bands = len(phi), basis.shape[1]
    for thread in prange(threads):
        for i in range(thread * m // threads, (thread + 1) * m // threads):
            for j in range(3):
                z = _ZERO
                for b in range(bands):
                    z += basis[ray[i], b] * phi[i, j * bands + b]
                out[index[i], j] = sigmoid(z)


@parallel_kernel
def harmonic_backward(basis, index, ray, colors, color_gradients, threads, phi_gradients):
    """phi_gradients [m, 3 bands] = dL/d(phi)."""
    m, bands = len(phi_gradients), basis.shape[1]
    for thread in prange(threads):
        for i in range(thread * m // threads, (thread + 1) * m // threads):
            k = index[i]
            for j in range(3):
                g = color_gradients[k, j] * colors[k, j] * (_ONE - colors[k, j])
                for b in range(bands):
                    phi_gradients[i, j * bands + b] = g * basis[ray[i], b]


# -- one hidden layer: sigmoid(W2 relu(W1 (phi, Y) + b1) + b2) ---------------------------------------------------------
#
# numbers, flat: W1 of the features [f, h], W1 of the harmonics [bands, h], b1 [h], W2 [3, h], b2 [3]. h is a
# compile-time constant, the length of the tuple `hidden`, so that a row of h floats is one vector. The direction's
# contribution to the hidden layer is computed once per ray.


@inline
def from_direction(numbers, at, basis, r, hidden, out):
    """out = b1 + sum_b Y_b W1_b; at: start of the harmonics' rows."""
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
    """out[index[i]] = color of sample i."""
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
    """Add the gradient of one ray's samples to W1 of the harmonics and to b1, at `at`."""
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
        # layer: output of the ReLU; back: dL/d(its input); learned: back summed over one ray's samples.
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
