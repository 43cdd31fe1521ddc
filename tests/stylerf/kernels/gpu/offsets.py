"""A kernel for the test of offsets beyond 2^31."""

import triton
import triton.language as tl

from stylerf.kernels.gpu.indexing import offset


@triton.jit(do_not_specialize=["width", "column"])
def offsets_kernel(rows, out, width, column, BLOCK: tl.constexpr):
    """out[i] = offset(rows[i], width, column)."""
    i = tl.arange(0, BLOCK)
    tl.store(out + i, offset(tl.load(rows + i), width, column))
