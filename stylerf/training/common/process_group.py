"""Data-parallel training of one field: each process takes part of a step's rays, and gradients are summed.

Every process draws the random numbers of the whole step and takes its own rays, so that together they do what a single
process would. Decisions depend only on sums and on the first process's clock, so all processes decide alike.
"""

import json
import os
from collections.abc import Callable
from contextlib import suppress
from datetime import timedelta
from typing import TYPE_CHECKING, Any

import numpy as np

from stylerf.errors import InvalidValue, ProcessLost

if TYPE_CHECKING:
    from torch import Tensor

LONGEST_WAIT = timedelta(days=7)  # the first process may render for hours; a dead process is noticed immediately
READING_WAIT = timedelta(seconds=10)
Checkpoint = tuple[dict, dict[str, np.ndarray]]


class ProcessGroup:
    """The group of processes that train together: just this one, or several (DistributedProcesses).

    first: whether this process decides, writes and prints.
    """

    count: int = 1
    place: int = 0
    first: bool = True

    def own(self, count: int) -> slice:
        """Return this process's contiguous slice of `count` rays, in process order."""
        return slice(0, count)

    def add(self, values: "np.ndarray | Tensor") -> None:
        """Replace values, on any device, with their sum over all processes."""

    def add_gradients(self, buffers: np.ndarray) -> None:
        """Sum the buffers [threads, n] of all processes into the first row and clear the other rows."""

    def of_first(self, value: float) -> float:
        """Return the first process's value."""
        return value

    def take_first(self, values: "np.ndarray | Tensor") -> None:
        """Replace values with those of the first process."""

    def checkpoint(self, saved: Checkpoint | None) -> Checkpoint | None:
        """Return the first process's checkpoint."""
        return saved

    def tell(self, text: str = "") -> str:
        """Return the first process's text; other processes' text is ignored."""
        return text

    def tell_fault(self, line: str) -> None:
        """Record this process's error for others to report, unless one is recorded already."""

    def leave(self) -> None:
        """Leave the group."""


SINGLE_PROCESS = ProcessGroup()


class DistributedProcesses(ProcessGroup):
    """Processes connected by torch.distributed, at the address that torchrun sets in the environment.

    Args:
        device: cpu (gloo) or cuda (gloo for host memory, NCCL for GPUs, one per process); anything else is the reason
            why this process has neither.

    Raises:
        InvalidValue: In every process, if devices differ or one has none.
    """

    def __init__(self, device: str = "cpu") -> None:
        import torch
        from torch import distributed
        from torch.distributed.rendezvous import rendezvous

        self._torch, self._distributed = torch, distributed
        # Under torchrun, the store outlives the processes, so errors are reported through it.
        self._store, self.place, self.count = next(iter(rendezvous("env://")))
        self.first = self.place == 0
        self._try(self._compare, self._taken(device))
        self._on_gpus = device == "cuda"
        backend = "cpu:gloo,cuda:nccl" if device == "cuda" else "gloo"
        self._try(
            distributed.init_process_group, backend,
            store=self._store, rank=self.place, world_size=self.count, timeout=LONGEST_WAIT,
        )  # fmt: skip

    def _taken(self, device: str) -> str:
        """Select this process's GPU; return `device`, or why it cannot be used."""
        if device == "cuda":
            try:
                self._torch.cuda.set_device(int(os.environ.get("LOCAL_RANK", "0")))
            except RuntimeError as error:
                return f"no GPU ({str(error).splitlines()[0]})"
        return device

    def _compare(self, device: str) -> None:
        """Compare devices through the store, since processes with different devices cannot form a group."""
        self._store.set_timeout(LONGEST_WAIT)
        self._store.set(f"stylerf device {self.place}", device)
        found = [self._store.get(f"stylerf device {place}").decode() for place in range(self.count)]
        if len(set(found)) == 1 and device in ("cpu", "cuda"):
            return
        self._await_readers()
        if len(set(found)) == 1:
            raise InvalidValue(device)
        listed = "; ".join(f"process {found.index(one)}: {one}" for one in dict.fromkeys(found))
        raise InvalidValue(f"processes that train together need devices of one kind, found {listed}")

    def _await_readers(self) -> None:
        """Wait until all have read the result: they are about to exit, and the first process may host the store."""
        self._store.set(f"stylerf read {self.place}", "")
        if self.place == 0:
            with suppress(RuntimeError):  # a dead process never reads
                self._store.wait([f"stylerf read {place}" for place in range(self.count)], READING_WAIT)

    def _try(self, collective: Callable, *arguments: Any, **more: Any) -> None:
        try:
            collective(*arguments, **more)
        except RuntimeError as error:  # raised by gloo, NCCL and the store when a connection closes
            self._abort()
            raise ProcessLost(self._reported_fault()) from error

    def own(self, count: int) -> slice:
        return slice(self.place * count // self.count, (self.place + 1) * count // self.count)

    def add(self, values: "np.ndarray | Tensor") -> None:
        # as_tensor shares the array's memory, so the sum is written in place.
        self._try(self._distributed.all_reduce, self._torch.as_tensor(values))

    def add_gradients(self, buffers: np.ndarray) -> None:
        for buffer in buffers[1:]:  # in the same order as a single process
            buffers[0] += buffer
        buffers[1:] = 0
        self.add(buffers[0])

    def of_first(self, value: float) -> float:
        received = np.array([value])
        self.take_first(received)
        return float(received[0])

    def take_first(self, values: "np.ndarray | Tensor") -> None:
        self._try(self._distributed.broadcast, self._torch.as_tensor(values), 0)

    def checkpoint(self, saved: Checkpoint | None) -> Checkpoint | None:
        data, arrays = saved or (None, {})
        listing = [[name, array.dtype.str, array.shape] for name, array in arrays.items()]
        data, listing = json.loads(self.tell(json.dumps([data, listing])))
        if not self.first:
            arrays = {name: np.empty(shape, dtype) for name, dtype, shape in listing}
        # In the first process's order, as listed: broadcasts are matched by order, not by name.
        for name, array in arrays.items():
            arrays[name] = np.ascontiguousarray(array)
            self.take_first(arrays[name].reshape(-1).view(np.uint8))
        return None if data is None else (data, arrays)

    def leave(self) -> None:
        self._distributed.destroy_process_group()

    def _abort(self) -> None:
        """Abort pending collectives: a GPU would wait for the lost process before doing anything else."""
        world = self._distributed.group.WORLD
        if world is not None and self._on_gpus:
            with suppress(RuntimeError):
                world._get_backend(self._torch.device("cuda")).abort()

    def tell(self, text: str = "") -> str:
        content = np.frombuffer(text.encode(), np.uint8).copy()
        length = int(self.of_first(len(content)))
        content = content if self.first else np.empty(length, np.uint8)
        self.take_first(content)
        return content.tobytes().decode()

    def tell_fault(self, line: str) -> None:
        try:
            self._store.compare_set("stylerf fault", "", f"process {self.place}: {line}")
        except RuntimeError:  # the first process hosted the store and is gone
            return

    def _reported_fault(self) -> str:
        try:
            if self._store.check(["stylerf fault"]):
                return self._store.get("stylerf fault").decode()
        except RuntimeError:
            pass
        return ""
