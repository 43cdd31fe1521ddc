"""Numbers of steps on their way from a device, and arrays on their way there, without a wait for what it still does."""

import numpy as np
import torch
from torch import Tensor

BEHIND = 8  # steps that the loop may run ahead of the device


class Late:
    """count: float32 numbers a step. They are told a few steps late; where tensors are the host's, at once."""

    def __init__(self, device: torch.device, count: int) -> None:
        on_gpu = device.type == "cuda"
        self._here = [torch.zeros(count, pin_memory=on_gpu) for _ in range(BEHIND)]
        self._beside = [0.0] * BEHIND
        self._done = [torch.cuda.Event() for _ in range(BEHIND)] if on_gpu else None
        self._sent, self._read = 0, 0
        self._newest = [0.0] * (count + 1)

    def send(self, numbers: Tensor, beside: float = 0.0) -> list[float]:
        """Have a step's numbers [count] brought over; those of the newest step that has arrived (at first: zeros).

        beside: a number that the host knows of the step, told behind the others. Waits for the step BEHIND steps ago.
        """
        if self._sent - self._read == BEHIND:
            self._take(wait=True)
        place = self._sent % BEHIND
        self._here[place].copy_(numbers, non_blocking=True)
        self._beside[place] = beside
        if self._done is not None:
            self._done[place].record()
        self._sent += 1
        while self._read < self._sent and self._take(wait=False):
            pass
        return self._newest

    def _take(self, wait: bool) -> bool:
        place = self._read % BEHIND
        if self._done is not None:
            if wait:
                self._done[place].synchronize()
            elif not self._done[place].query():
                return False
        self._newest = [*self._here[place].tolist(), self._beside[place]]
        self._read += 1
        return True


def sent(array: np.ndarray, device: torch.device) -> Tensor:
    """A copy of a host array on the device."""
    tensor = torch.from_numpy(array)
    if device.type == "cuda":
        return tensor.pin_memory().to(device, non_blocking=True)
    return tensor.to(device, copy=True)
