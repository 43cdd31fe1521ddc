"""Asynchronous transfers between host and device.

A loop runs at most BEHIND steps ahead of the device, so that its wall-clock time reflects the device's.
"""

from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

import numpy as np
import torch
from torch import Tensor

BEHIND = 8
Note = TypeVar("Note")
Result = TypeVar("Result")


class AsyncReadback(Generic[Note, Result]):
    """Reads `width` sums per step back from the device, with a delay of a few steps.

    Args:
        read: Computes the result from a step's sums and its note.
        first: The result until the first step has arrived.
        in_step: Return the result of exactly BEHIND steps ago instead of the newest one that has arrived, because
            processes that train together must all get the same result.
    """

    def __init__(
        self,
        device: torch.device,
        width: int,
        read: Callable[[list[float], Note], Result],
        first: Result,
        in_step: bool = False,
    ) -> None:
        on_gpu = device.type == "cuda"
        self._there = [torch.zeros(width, device=device) for _ in range(BEHIND)]
        self._here = [torch.zeros(width, pin_memory=on_gpu) for _ in range(BEHIND)]
        self._notes: deque[Note] = deque()  # of steps that were sent but not read yet
        self._done = [torch.cuda.Event() for _ in range(BEHIND)] if on_gpu else None
        self._sent, self._read = 0, 0
        self._result_of, self._newest, self._in_step = read, first, in_step

    def begin(self) -> Tensor:
        """Return zeroed sums [width] for the next step; waits for the step BEHIND steps ago."""
        if self._sent - self._read == BEHIND:
            self._take(wait=True)
        return self._there[self._sent % BEHIND].zero_()

    def send(self, note: Note) -> Result:
        """Start reading back the step's sums; return the newest result."""
        place = self._sent % BEHIND
        # The slot is overwritten BEHIND steps later, after begin() has read it.
        self._here[place].copy_(self._there[place], non_blocking=True)
        self._notes.append(note)
        if self._done is not None:
            self._done[place].record()
        self._sent += 1
        # Which steps have arrived depends on timing, so processes in lockstep may only take results that begin()
        # waited for.
        while not self._in_step and self._read < self._sent and self._take(wait=False):
            pass
        return self._newest

    def settle(self) -> Result:
        """Wait for all steps; return the last step's result."""
        while self._read < self._sent:
            self._take(wait=True)
        return self._newest

    def _take(self, wait: bool) -> bool:
        place = self._read % BEHIND
        if self._done is not None:
            if wait:
                self._done[place].synchronize()
            elif not self._done[place].query():
                return False
        self._newest = self._result_of(self._here[place].tolist(), self._notes.popleft())
        self._read += 1
        return True


def sent(array: np.ndarray, device: torch.device) -> Tensor:
    """Return a copy of the array on the device; to a GPU, it is asynchronous, from pinned memory."""
    there = torch.from_numpy(np.ascontiguousarray(array))
    return there.pin_memory().to(device, non_blocking=True) if device.type == "cuda" else there.to(device)
