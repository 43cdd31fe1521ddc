"""Adam over the flat value arrays of field parts."""

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from stylerf.kernels.cpu.adam import AdamRates, AdamState, adam

if TYPE_CHECKING:
    from torch import Tensor

# As in Instant-NGP: averaged over thousands of rays, a table row's gradient is tiny; a larger epsilon would damp it.
BETA1, BETA2, EPSILON = 0.9, 0.99, 1e-15
NORM_STEPS = 10  # steps after which the running gradient norm is reliable enough for clipping
SMOOTH_EVERY = 8  # steps between total variation gradients, which cost a third of a step and act over hundreds of steps
SUMMED = 1 << 16  # number of values whose gradients are summed over threads at a time


class Adam:
    """Moments and gradient buffers for one array `values`; each step clears the gradients [threads, n].

    groups: (begin, end, learning-rate factor). gradient_clip: see clipped(); 0: never clip.
    """

    def __init__(
        self, values: np.ndarray, groups: list[tuple[int, int, float]], threads: int, gradient_clip: float = 0.0
    ) -> None:
        self.values, self.groups, self.threads, self.gradient_clip = values, groups, threads, gradient_clip
        self.running_norm = 0.0
        self.gradients = np.zeros((threads, len(values)), np.float32)
        self.first, self.second = np.zeros_like(values), np.zeros_like(values)
        self.steps = 0

    def step(self, rate: float) -> None:
        """Take one step with learning rate `rate` times each group's factor."""
        if self.gradient_clip > 0:
            self.running_norm = clipped(self.gradients, self.gradient_clip, self.running_norm, self.steps)
        self.steps += 1
        state = AdamState(self.values, self.gradients, self.first, self.second)
        for begin, end, factor in self.groups:
            adam(state, rates_of(rate * factor, self.steps, np.float32), begin, end, self.threads)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays for a checkpoint, without the values."""
        steps = np.asarray([self.steps, self.running_norm], np.float64)
        return {"first": self.first, "second": self.second, "steps": steps}

    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        """Restore the state from arrays()."""
        self.first[:], self.second[:] = arrays["first"], arrays["second"]
        self.steps = int(arrays["steps"][0])
        self.running_norm = float(arrays["steps"][1]) if len(arrays["steps"]) > 1 else 0.0


def rates_of(rate: float, steps: int, dtype: Callable[[float], Any] = float) -> AdamRates:
    """Return Adam's coefficients for step `steps`, counted from 1, as `dtype`.

    Steps are counted per optimizer, not per row: the kernel skips runs without a gradient, whose moments then do not
    decay.
    """
    return AdamRates(*map(dtype, (rate, BETA1, BETA2, EPSILON, 1 - BETA1**steps, 1 - BETA2**steps)))


class Optimizer(Protocol):
    """Common interface of Adam and GpuAdam."""

    @property
    def values(self) -> "np.ndarray | Tensor": ...

    @property
    def gradients(self) -> "np.ndarray | Tensor": ...

    def step(self, rate: float) -> None: ...

    def arrays(self) -> dict[str, np.ndarray]: ...

    def restore(self, arrays: dict[str, np.ndarray]) -> None: ...


def moments_of(optimizers: Mapping[str, Optimizer]) -> dict[str, np.ndarray]:
    """Return the checkpoint arrays of several optimizers, by name; the next step may overwrite them."""
    return {f"{name}.{k}": v for name, one in optimizers.items() for k, v in one.arrays().items()}


def restore_moments(optimizers: Mapping[str, Optimizer], arrays: Mapping[str, np.ndarray]) -> None:
    """Restore optimizers from moments_of(); `arrays` may hold other entries."""
    for name, one in optimizers.items():
        one.restore({k: arrays[f"{name}.{k}"] for k in ("first", "second", "steps")})


def clipped(gradients: np.ndarray, gradient_clip: float, running_norm: float, steps: int) -> float:
    """Clip the sum over threads of gradients [threads, n], in place, to `gradient_clip` times the running norm.

    During the first NORM_STEPS steps, the running norm is the plain mean of the norms and nothing is clipped: a network
    whose last layer starts at zero has almost no gradient at first. After that, it is an exponential moving average
    (decay 0.9) of the clipped norms. All-zero gradients do not count. Non-finite gradients are set to zero: a single
    NaN ray would otherwise stay in the moments forever.

    Args:
        steps: Number of steps taken before.

    Returns:
        The new running norm.
    """
    norm = _norm(gradients)
    if not np.isfinite(norm):
        gradients[:] = 0
        return running_norm
    # Without a running norm yet, the first nonzero norm becomes it.
    if norm == 0 or running_norm == 0:
        return running_norm or norm
    if steps < NORM_STEPS:
        return running_norm + (norm - running_norm) / (steps + 1)
    if norm > gradient_clip * running_norm:
        gradients *= np.float32(gradient_clip * running_norm / norm)
        # The mean uses the clipped norm, so that a spike does not raise the limit for the steps after it.
        norm = gradient_clip * running_norm
    return 0.9 * running_norm + 0.1 * norm


def _norm(gradients: np.ndarray) -> float:
    """Return the norm of the sum over threads, in parts: running out of memory must not leave a step half done."""
    squares = 0.0
    for at in range(0, gradients.shape[1], SUMMED):
        squares += float(np.square(gradients[:, at : at + SUMMED].sum(0), dtype=np.float64).sum())
    return math.sqrt(squares)
