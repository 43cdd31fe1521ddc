"""In Triton's interpreter, every load, store and atomic must lie within a tensor that its kernel was given.

The interpreter checks no addresses: a kernel that reads or writes beyond an array would pass, or crash much later.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
import torch


class OutOfBounds(AssertionError):
    """A kernel reached beyond its tensors."""


class Bounds:
    """The address ranges of the tensors of the kernel that runs."""

    def __init__(self) -> None:
        self.kernel, self.ranges = "", np.empty((0, 2), np.int64)

    def enter(self, kernel: str, arguments: list[Any]) -> None:
        """Take over a kernel's arguments."""
        tensors = [one for one in arguments if isinstance(one, torch.Tensor)]
        ranges = [(one.data_ptr(), one.data_ptr() + one.numel() * one.element_size()) for one in tensors]
        self.kernel, self.ranges = kernel, np.array(ranges, np.int64).reshape(-1, 2)

    def check(self, what: str, pointers: Any, mask: Any) -> None:
        """Raise OutOfBounds unless every pointer under the mask leads into one of the ranges."""
        size = pointers.get_element_ty().primitive_bitwidth // 8
        addresses = np.asarray(pointers.data).astype(np.int64).ravel()
        addresses = addresses[np.broadcast_to(np.asarray(mask.data, bool), np.shape(pointers.data)).ravel()]
        begins, ends = self.ranges[:, 0, None], self.ranges[:, 1, None]
        within = ((addresses >= begins) & (addresses + size <= ends)).any(axis=0)
        if not within.all():
            outside = (~within).sum()
            raise OutOfBounds(f"{self.kernel}: {outside} of {within.size} addresses of a {what} are in no tensor")


@contextmanager
def bounds_checked() -> Iterator[None]:
    """Check the bounds of every kernel that runs in Triton's interpreter."""
    from triton.runtime import interpreter

    bounds, builder, patch = Bounds(), interpreter.InterpreterBuilder, pytest.MonkeyPatch()
    call, load = interpreter.GridExecutor.__call__, builder.create_masked_load
    store, atomic = builder.create_masked_store, builder.create_atomic_rmw

    def checked_call(self, *given, **named):
        bounds.enter(self.fn.__name__, [*given, *named.values()])
        return call(self, *given, **named)

    def checked_load(self, pointers, mask, *given):
        bounds.check("load", pointers, mask)
        return load(self, pointers, mask, *given)

    def checked_store(self, pointers, value, mask, *given):
        bounds.check("store", pointers, mask)
        return store(self, pointers, value, mask, *given)

    def checked_atomic(self, operation, pointers, value, mask, *given):
        bounds.check("atomic", pointers, mask)
        return atomic(self, operation, pointers, value, mask, *given)

    with patch.context() as patched:
        patched.setattr(interpreter.GridExecutor, "__call__", checked_call)
        patched.setattr(builder, "create_masked_load", checked_load)
        patched.setattr(builder, "create_masked_store", checked_store)
        patched.setattr(builder, "create_atomic_rmw", checked_atomic)
        yield
