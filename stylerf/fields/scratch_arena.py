"""Memory for samples: its pages are taken as they are written, and what comes next uses them again.

A batch of rays, or a part of a view, has room for many times its samples: every page of it that is written to would
be new to the process, and cleared before it is used.
"""

import math
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

_here = threading.local()


def room(shape: tuple[int, ...], dtype=np.float32) -> np.ndarray:
    """An array of any content, as numpy.empty; within a round of a Memory, of what its last round has written to."""
    held: ScratchArena | None = getattr(_here, "held", None)
    return np.empty(shape, dtype) if held is None else held.next(shape, np.dtype(dtype))


class ScratchArena:
    """What room() gives, round after round: nothing of a round may outlive it."""

    def __init__(self) -> None:
        self._blocks: list[np.ndarray] = []
        self._given = 0

    @contextmanager
    def round(self) -> Iterator[None]:
        """A round: room() gives of this memory, in this thread, until it ends."""
        before, _here.held = getattr(_here, "held", None), self
        self._given = 0
        try:
            yield
        finally:
            _here.held = before

    def next(self, shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
        """An array of any content that no other of this round shares."""
        length = math.prod(shape) * dtype.itemsize
        if self._given == len(self._blocks):
            self._blocks.append(np.empty(0, np.uint8))
        if len(self._blocks[self._given]) < length:
            # Batches grow little by little: with some to spare, not each of them begins with new memory.
            self._blocks[self._given] = np.empty(length + length // 4, np.uint8)
        block = self._blocks[self._given]
        self._given += 1
        return block[:length].view(dtype).reshape(shape)
