"""Memory for samples: its pages are taken as they are written, and a view that is rendered in parts uses them again."""

import math
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

_here = threading.local()


def room(shape: tuple[int, ...], dtype=np.float32) -> np.ndarray:
    """An array of any content, as numpy.empty; within `reused()` of memory that its last round has written to."""
    held: _Held | None = getattr(_here, "held", None)
    return np.empty(shape, dtype) if held is None else held.next(shape, np.dtype(dtype))


@contextmanager
def reused() -> Iterator["_Held"]:
    """What room() gives in this thread is given again after each `begin_round()`: nothing of a round may outlive it.

    A part of a view has room for many times its samples, so that every page of it is new to the process and cleared
    before it is used: a tenth of the time of a part (lego 200x200 and 400x400, 8192 rays).
    """
    _here.held = _Held()
    try:
        yield _here.held
    finally:
        _here.held = None


class _Held:
    def __init__(self) -> None:
        self._blocks: list[np.ndarray] = []
        self._given = 0

    def begin_round(self) -> None:
        self._given = 0

    def next(self, shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
        length = math.prod(shape) * dtype.itemsize
        if self._given == len(self._blocks):
            self._blocks.append(np.empty(length, np.uint8))
        elif len(self._blocks[self._given]) < length:
            self._blocks[self._given] = np.empty(length, np.uint8)
        block = self._blocks[self._given]
        self._given += 1
        return block[:length].view(dtype).reshape(shape)
