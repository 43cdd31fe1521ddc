"""Adam over the flat value arrays of field parts."""

import math

import numpy as np

from stylerf.kernels.cpu.adam import adam

BETA1, BETA2, EPSILON = 0.9, 0.99, 1e-15
UNKNOWN = 10  # steps after which it is known how long a gradient usually is
SMOOTH_EVERY = 8  # steps between total variation gradients: they cost a third of a step, and act over hundreds of steps
SUMMED = 1 << 16  # values whose gradients are summed over the chunks at a time


class Adam:
    """Moments and gradient buffers of one array `values`; gradients [chunks, n] are cleared by each step.

    clip: over 0, no gradient counts as longer than so many times what is usual, see `clipped`; 0: none is looked at.
    """

    def __init__(self, values: np.ndarray, groups: list[tuple[int, int, float]], chunks: int, clip: float = 0.0):
        self.values, self.groups, self.chunks, self.clip = values, groups, chunks, clip
        self.usual = 0.0
        self.gradients = np.zeros((chunks, len(values)), np.float32)
        self.first, self.second = np.zeros_like(values), np.zeros_like(values)
        self.steps = 0

    def step(self, rate: float) -> None:
        """One update with learning rate `rate` times each group's factor."""
        if self.clip > 0:
            self.usual = clipped(self.gradients, self.clip, self.usual, self.steps)
        self.steps += 1
        corrections = np.float32(1 - BETA1**self.steps), np.float32(1 - BETA2**self.steps)
        for begin, end, factor in self.groups:
            adam(
                self.values,
                self.gradients,
                self.first,
                self.second,
                np.float32(rate * factor),
                np.float32(BETA1),
                np.float32(BETA2),
                np.float32(EPSILON),
                *corrections,
                begin,
                end,
                self.chunks,
            )

    def arrays(self) -> dict[str, np.ndarray]:
        """What a checkpoint needs beside the values."""
        return {"first": self.first, "second": self.second, "steps": np.asarray([self.steps, self.usual], np.float64)}

    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        """From arrays()."""
        self.first[:], self.second[:] = arrays["first"], arrays["second"]
        self.steps = int(arrays["steps"][0])
        self.usual = float(arrays["steps"][1]) if len(arrays["steps"]) > 1 else 0.0


def clipped(gradients: np.ndarray, clip: float, usual: float, steps: int) -> float:
    """Shortens the sum over chunks of gradients [chunks, n], in place, to `clip` times the usual length; the new usual.

    usual: of the first UNKNOWN steps the plain mean of the lengths, of which none is shortened: a network whose last
    layer begins at zero has next to no gradient at first. Then a running mean (9 parts of 10 the past) of the lengths
    after clipping. Gradients of nothing but zeros tell nothing. One that is not finite counts as none: one ray of NaN
    would otherwise stay in the moments for good. steps: taken before.
    """
    length = _length(gradients)
    if not np.isfinite(length):
        gradients[:] = 0
        return usual
    if length == 0 or usual == 0:
        return usual or length
    if steps < UNKNOWN:
        return usual + (length - usual) / (steps + 1)
    if length > clip * usual:
        gradients *= np.float32(clip * usual / length)
        length = clip * usual
    return 0.9 * usual + 0.1 * length


def _length(gradients: np.ndarray) -> float:
    """Of the sum over chunks. A part at a time: where memory lacks, half of a step must not have been made."""
    squares = 0.0
    for at in range(0, gradients.shape[1], SUMMED):
        squares += float(np.square(gradients[:, at : at + SUMMED].sum(0), dtype=np.float64).sum())
    return math.sqrt(squares)
