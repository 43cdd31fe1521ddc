"""Adam over the flat value tensors of field parts on a GPU; the host never waits for it."""

import numpy as np
import torch
from torch import Tensor

from stylerf.kernels.gpu import launch
from stylerf.training.common.adam import BETA1, BETA2, EPSILON, UNKNOWN


class GpuAdam:
    """adam.py's Adam, on tensors: one gradient buffer, added to by atomics."""

    def __init__(self, values: Tensor, groups: list[tuple[int, int, float]], clip: float = 0.0) -> None:
        self.values, self.groups, self.clip = values, groups, clip
        self.gradients, self.first, self.second = (torch.zeros_like(values) for _ in range(3))
        self.usual = torch.zeros((), dtype=torch.float64, device=values.device)
        self.steps = 0

    def step(self, rate: float) -> None:
        """One update with learning rate `rate` times each group's factor; clears the gradients."""
        if self.clip > 0:
            self.usual = clipped(self.gradients, self.clip, self.usual, self.steps)
        self.steps += 1
        corrections = 1 - BETA1**self.steps, 1 - BETA2**self.steps
        for begin, end, factor in _joined(self.groups):
            launch.adam(
                self.values, self.gradients, self.first, self.second, rate * factor, (BETA1, BETA2), EPSILON,
                corrections, begin, end,
            )  # fmt: skip

    def arrays(self) -> dict[str, np.ndarray]:
        """What a checkpoint needs beside the values."""
        moments = {"first": self.first.cpu().numpy(), "second": self.second.cpu().numpy()}
        return moments | {"steps": np.asarray([self.steps, float(self.usual)])}

    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        """From arrays()."""
        self.first.copy_(torch.from_numpy(arrays["first"]))
        self.second.copy_(torch.from_numpy(arrays["second"]))
        self.steps = int(arrays["steps"][0])
        self.usual.fill_(float(arrays["steps"][1]) if len(arrays["steps"]) > 1 else 0.0)


def clipped(gradients: Tensor, clip: float, usual: Tensor, steps: int) -> Tensor:
    """As adam.py's, of gradients [n]; nothing of it is asked of the host."""
    length = torch.linalg.vector_norm(gradients, dtype=torch.float64)
    tells, known = torch.isfinite(length) & (length > 0), usual > 0
    shortened = torch.minimum(length, clip * usual) if steps >= UNKNOWN else length
    shortened = torch.where(known, shortened, length)
    share = torch.where(length > 0, shortened / length, 1.0)
    gradients.mul_(torch.where(torch.isfinite(length), share, 0.0).to(gradients.dtype)).nan_to_num_(0.0, 0.0, 0.0)
    newest = 0.1 if steps >= UNKNOWN else 1 / (steps + 1)
    return torch.where(tells, torch.where(known, usual + newest * (shortened - usual), shortened), usual)


def _joined(groups: list[tuple[int, int, float]]) -> list[tuple[int, int, float]]:
    """Neighboring groups of one factor as one: a launch less. A run of eight may then span both."""
    joined: list[tuple[int, int, float]] = []
    for begin, end, factor in groups:
        if joined and joined[-1][1] == begin and joined[-1][2] == factor:
            joined[-1] = joined[-1][0], end, factor
        else:
            joined.append((begin, end, factor))
    return joined
