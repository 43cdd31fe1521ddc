"""Adam over the flat value tensors of field parts on a GPU, without synchronization."""

from typing import Self

import numpy as np
import torch
from torch import Tensor

from stylerf.fields.gpu.parts import GpuPart
from stylerf.kernels.gpu import launch
from stylerf.kernels.gpu.ray_samples import GpuAdamState
from stylerf.training.common.adam import NORM_STEPS, rates_of


class GpuAdam:
    """Adam as in adam.py, on tensors, with a single gradient buffer that is accumulated atomically."""

    def __init__(self, values: Tensor, groups: list[tuple[int, int, float]], gradient_clip: float = 0.0) -> None:
        self.values, self.groups, self.gradient_clip = values, groups, gradient_clip
        self.gradients, self.first, self.second = (torch.zeros_like(values) for _ in range(3))
        self.running_norm = torch.zeros((), dtype=torch.float64, device=values.device)
        self.steps = 0

    @classmethod
    def of(cls, part: GpuPart, gradient_clip: float = 0.0) -> Self:
        """Return an optimizer for all values of a part."""
        return cls(part.values, part.groups, gradient_clip)

    def step(self, rate: float) -> None:
        """Take one step with learning rate `rate` times each group's factor, then clear the gradients."""
        if self.gradient_clip > 0:
            self.running_norm = clipped(self.gradients, self.gradient_clip, self.running_norm, self.steps)
        self.steps += 1
        state = GpuAdamState(self.values, self.gradients, self.first, self.second)
        for begin, end, factor in _joined(self.groups):
            launch.adam(state, rates_of(rate * factor, self.steps), begin, end)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays for a checkpoint, without the values."""
        moments = {"first": self.first.cpu().numpy(), "second": self.second.cpu().numpy()}
        return moments | {"steps": np.asarray([self.steps, float(self.running_norm)])}

    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        """Restore the state from arrays()."""
        self.first.copy_(torch.from_numpy(arrays["first"]))
        self.second.copy_(torch.from_numpy(arrays["second"]))
        self.steps = int(arrays["steps"][0])
        self.running_norm.fill_(float(arrays["steps"][1]) if len(arrays["steps"]) > 1 else 0.0)


def clipped(gradients: Tensor, gradient_clip: float, running_norm: Tensor, steps: int) -> Tensor:
    """Clip gradients [n] as clipped() in adam.py does, without synchronization."""
    # Branching on device values would synchronize, so every case is a torch.where.
    norm = torch.linalg.vector_norm(gradients, dtype=torch.float64)
    counts, known = torch.isfinite(norm) & (norm > 0), running_norm > 0
    clipped_norm = torch.minimum(norm, gradient_clip * running_norm) if steps >= NORM_STEPS else norm
    clipped_norm = torch.where(known, clipped_norm, norm)
    factor = torch.where(torch.isfinite(norm), torch.where(norm > 0, clipped_norm / norm, 1.0), 0.0)
    # For a non-finite norm the factor is 0, but 0 * inf and 0 * nan are NaN.
    gradients.mul_(factor.to(gradients.dtype)).nan_to_num_(0.0, 0.0, 0.0)
    newest = 0.1 if steps >= NORM_STEPS else 1 / (steps + 1)
    mean = torch.where(known, running_norm + newest * (clipped_norm - running_norm), clipped_norm)
    return torch.where(counts, mean, running_norm)


def _joined(groups: list[tuple[int, int, float]]) -> list[tuple[int, int, float]]:
    """Merge neighboring groups with the same factor, to save launches. A run of eight values may then span both."""
    joined: list[tuple[int, int, float]] = []
    for begin, end, factor in groups:
        if joined and joined[-1][1] == begin and joined[-1][2] == factor:
            joined[-1] = joined[-1][0], end, factor
        else:
            joined.append((begin, end, factor))
    return joined
