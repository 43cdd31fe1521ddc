"""Adam over the flat value arrays of field parts."""

import numpy as np

from stylerf.kernels.cpu.optimiser import adam

BETA1, BETA2, EPSILON = 0.9, 0.99, 1e-15


class Adam:
    """Moments and gradient buffers of one array `values`; gradients [chunks, n] are cleared by each step."""

    def __init__(self, values: np.ndarray, groups: list[tuple[int, int, float]], chunks: int) -> None:
        self.values, self.groups, self.chunks = values, groups, chunks
        self.gradients = np.zeros((chunks, len(values)), np.float32)
        self.first, self.second = np.zeros_like(values), np.zeros_like(values)
        self.steps = 0

    def step(self, rate: float) -> None:
        """One update with learning rate `rate` times each group's factor."""
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
        return {"first": self.first, "second": self.second, "steps": np.asarray([self.steps])}

    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        """From arrays()."""
        self.first[:], self.second[:] = arrays["first"], arrays["second"]
        self.steps = int(arrays["steps"][0])
