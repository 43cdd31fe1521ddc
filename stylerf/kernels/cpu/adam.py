"""Adam (Kingma & Ba 2015) over flat tables: sums the threads' buffers in order, updates and clears them in one pass.

numba does not vectorize a loop over an optimizer's four arrays, since they might alias: a square root and two divisions
per element then cost more than the memory accesses (performance.md). The intrinsics in LLVM IR load, compute and store
runs of LANES elements as one vector, with the same rounding as the scalar formulas.
"""

import math
from typing import NamedTuple

import numpy as np
from llvmlite import ir
from numba import prange, types
from numba.core import cgutils
from numba.extending import intrinsic

from stylerf.kernels.cpu.compiling import parallel_kernel
from stylerf.kernels.cpu.simd_vm import INDEX, SCALAR, Rows, data_pointer

LANES = 8  # floats; the GPU kernel skips runs of the same length
_ONE, _ZERO = np.float32(1), np.float32(0)


@intrinsic
def any_gradient(typing, gradients, at):
    """Whether any of gradients[at : at + LANES] (flat) is nonzero; NaN counts as nonzero."""

    def generate(context, builder, sig, args):
        rows = Rows(builder, LANES)
        row = rows.load(data_pointer(context, builder, sig.args[0], args[0]), args[1])
        found = builder.fcmp_unordered("!=", row, ir.Constant(rows.type, [0.0] * LANES))
        # As a single integer of LANES bits.
        bits = builder.bitcast(found, ir.IntType(LANES))
        return builder.icmp_unsigned("!=", bits, ir.Constant(ir.IntType(LANES), 0))

    return types.boolean(gradients, INDEX), generate


@intrinsic
def gather_gradient(typing, gradients, at, other):
    """gradients[at : at + LANES] += gradients[other : other + LANES] (flat); clears the latter."""

    def generate(context, builder, sig, args):
        rows = Rows(builder, LANES)
        pointer = data_pointer(context, builder, sig.args[0], args[0])
        rows.add_to(pointer, args[1], rows.load(pointer, args[2]))
        rows.store(pointer, args[2], ir.Constant(rows.type, [0.0] * LANES))
        return context.get_dummy_value()

    return types.void(gradients, INDEX, INDEX), generate


@intrinsic
def adam_run(typing, values, gradients, first, second, i, at, rate, beta1, beta2, epsilon, root):
    """One step for LANES elements starting at i, with gradients[at:] (flat), which are cleared.

    m = beta1 m + (1 - beta1) g, v = beta2 v + (1 - beta2) g^2, value -= rate m / (root sqrt(v) + epsilon); rate and
    root include the bias corrections.
    """

    def generate(context, builder, sig, args):
        rows = Rows(builder, LANES)
        places = [data_pointer(context, builder, sig.args[k], args[k]) for k in range(4)]
        value_at, gradient_at, first_at, second_at = places
        i, at = args[4:6]
        rate, beta1, beta2, epsilon, root = (rows.splat(scalar) for scalar in args[6:])
        one = ir.Constant(rows.type, [1.0] * LANES)
        gradient = rows.load(gradient_at, at)
        rows.store(gradient_at, at, ir.Constant(rows.type, [0.0] * LANES))
        m = rows.add(rows.mul(beta1, rows.load(first_at, i)), rows.mul(rows.sub(one, beta1), gradient))
        squared = rows.mul(rows.mul(rows.sub(one, beta2), gradient), gradient)
        v = rows.add(rows.mul(beta2, rows.load(second_at, i)), squared)
        rows.store(first_at, i, m)
        rows.store(second_at, i, v)
        name = f"llvm.sqrt.v{LANES}f32"
        sqrt = cgutils.get_or_insert_function(builder.module, ir.FunctionType(rows.type, [rows.type]), name)
        below = rows.add(rows.mul(root, builder.call(sqrt, [v])), epsilon)
        step = builder.fdiv(rows.mul(rate, m), below)
        rows.store(value_at, i, rows.sub(rows.load(value_at, i), step))
        return context.get_dummy_value()

    return types.void(values, gradients, first, second, INDEX, INDEX, *[SCALAR] * 5), generate


class AdamState(NamedTuple):
    """A table and its optimizer state: values and both moments [n], gradients [threads, n], float32."""

    values: np.ndarray
    gradients: np.ndarray
    first: np.ndarray
    second: np.ndarray


class AdamRates(NamedTuple):
    """Coefficients of step t: correction1 = 1 - beta1^t, correction2 = 1 - beta2^t."""

    rate: float
    beta1: float
    beta2: float
    epsilon: float
    correction1: float
    correction2: float


@parallel_kernel
def adam(state, rates, begin, end, blocks):
    """One Adam step on values[begin:end]; gradients are summed over threads, then cleared. rates: float32.

    Runs of eight elements without any gradient are skipped, including their moments (as in torch.optim.SparseAdam): a
    batch of rays touches only a small part of a table.
    """
    values, gradients, first, second = state.values, state.gradients, state.first, state.second
    beta1, beta2, epsilon = rates.beta1, rates.beta2, rates.epsilon
    threads, stride = gradients.shape
    flat = gradients.reshape(-1)
    runs = (end - begin) // LANES
    step, root = rates.rate / rates.correction1, _ONE / np.float32(math.sqrt(rates.correction2))
    for b in prange(blocks):
        for run in range(b * runs // blocks, (b + 1) * runs // blocks):
            at = begin + run * LANES
            touched = any_gradient(flat, at)
            for thread in range(1, threads):
                touched |= any_gradient(flat, thread * stride + at)
            if not touched:
                continue
            # In thread order, so that sums are bit-reproducible.
            for thread in range(1, threads):
                gather_gradient(flat, at, thread * stride + at)
            adam_run(values, flat, first, second, at, at, step, beta1, beta2, epsilon, root)
    # The remaining elements, fewer than LANES: one short run, also skipped as a whole.
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
