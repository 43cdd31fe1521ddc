"""Kernels that touch the first `count` values of a tensor, however many it has."""

import triton
import triton.language as tl


@triton.jit
def load_kernel(values, count, BLOCK: tl.constexpr):
    at = tl.arange(0, BLOCK)
    tl.load(values + at, mask=at < count)


@triton.jit
def store_kernel(values, count, BLOCK: tl.constexpr):
    at = tl.arange(0, BLOCK)
    tl.store(values + at, 1.0, mask=at < count)


@triton.jit
def atomic_kernel(values, count, BLOCK: tl.constexpr):
    at = tl.arange(0, BLOCK)
    tl.atomic_add(values + at, 1.0, mask=at < count)
