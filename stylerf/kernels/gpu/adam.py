"""Adam on flat tables in one pass; see kernels/cpu/adam.py."""

import triton
import triton.language as tl


@triton.jit(do_not_specialize=["begin", "end"])
def adam_kernel(
    values, gradients, first, second, rate, beta1, beta2, epsilon, correction1, correction2, begin, end,
    BLOCK: tl.constexpr,
):  # fmt: skip
    """One step on values[begin:end], which clears gradients. Runs of eight without any gradient are skipped."""
    run = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    at = begin + run[:, None] * 8 + tl.arange(0, 8)[None, :]
    inside = at < end
    g = tl.load(gradients + at, mask=inside, other=0.0)
    # A NaN counts as nonzero: the update spreads it, and the loss shows it.
    touched = tl.max((g != 0.0).to(tl.int32), axis=1) > 0
    mask = inside & touched[:, None]
    m = beta1 * tl.load(first + at, mask=mask, other=0.0) + (1.0 - beta1) * g
    v = beta2 * tl.load(second + at, mask=mask, other=0.0) + (1.0 - beta2) * g * g
    tl.store(first + at, m, mask=mask)
    tl.store(second + at, v, mask=mask)
    # Runs that are skipped hold zeros already.
    tl.store(gradients + at, 0.0 * at.to(tl.float32), mask=mask)
    down = rate * (m / correction1) / (tl.sqrt(v / correction2) + epsilon)
    tl.store(values + at, tl.load(values + at, mask=mask, other=0.0) - down, mask=mask)
