"""Adam over the flat value arrays of field parts."""

import numpy as np

from stylerf.kernels.cpu.optimiser import adam

BETA1, BETA2, EPSILON = 0.9, 0.99, 1e-15


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
            self.usual = clipped(self.gradients, self.clip, self.usual)
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


def clipped(gradients: np.ndarray, clip: float, usual: float) -> float:
    """Shortens the sum over chunks of gradients [chunks, n], in place, to `clip` times the usual length; the new usual.

    usual: running mean (9 parts of 10 the past) of the lengths after clipping; 0 before the first step, which sets it.
    A gradient that is not finite counts as none: one ray of NaN would otherwise stay in the moments for good.
    """
    whole = gradients.sum(0) if len(gradients) > 1 else gradients[0]
    length = float(np.sqrt(np.square(whole, dtype=np.float64).sum()))
    if not np.isfinite(length):
        gradients[:] = 0
        return usual
    if usual > 0 and length > clip * usual:
        gradients *= np.float32(clip * usual / length)
        length = clip * usual
    return 0.9 * usual + 0.1 * length if usual > 0 else length
