"""Several processes that train one field: each works on its part of a step's rays, and gradients are summed.

Every process draws the whole step's random numbers and takes its own part of the rays, so that together they do what
one process does with all of them. Decisions depend on sums and on the first process's clock alone: all take the same.
"""

import json
import os
from collections.abc import Callable
from contextlib import suppress
from datetime import timedelta
from typing import Any, Protocol

import numpy as np

from stylerf.errors import InvalidValue, ProcessLost

LONGEST_WAIT = timedelta(days=7)  # the first process may render for hours; one that dies is noticed at once
READING_WAIT = timedelta(seconds=10)
Checkpoint = tuple[dict, dict[str, np.ndarray]]


class ProcessGroup(Protocol):
    """This process's place among those that train together. first: the one that decides, writes and speaks."""

    count: int
    place: int
    first: bool

    def own(self, count: int) -> slice:
        """This process's part of `count` rays: one after another, in the order of the processes."""

    def add(self, values: np.ndarray) -> None:
        """Puts the sum over all processes in the place of values (numpy, or torch on any device), alike everywhere."""

    def add_gradients(self, buffers: np.ndarray) -> None:
        """Buffers [threads, n] of all processes, summed into the first row; the others are cleared."""

    def of_first(self, value: float) -> float:
        """The first process's value."""

    def take_first(self, values: np.ndarray) -> None:
        """Puts the first process's values in the place of these."""

    def checkpoint(self, saved: Checkpoint | None) -> Checkpoint | None:
        """The first process's checkpoint."""

    def tell(self, text: str = "") -> str:
        """The first process's text; the others' own is ignored."""

    def tell_fault(self, line: str) -> None:
        """Leaves this process's fault for the first one to report."""

    def leave(self) -> None:
        """Nothing more is to be done together."""


class SingleProcess:
    """One process: its part is the whole, its sums are its own."""

    count, place, first = 1, 0, True

    def own(self, count: int) -> slice:
        return slice(0, count)

    def add(self, values: np.ndarray) -> None: ...

    def add_gradients(self, buffers: np.ndarray) -> None: ...

    def of_first(self, value: float) -> float:
        return value

    def take_first(self, values: np.ndarray) -> None: ...

    def checkpoint(self, saved: Checkpoint | None) -> Checkpoint | None:
        return saved

    def tell(self, text: str = "") -> str:
        return text

    def tell_fault(self, line: str) -> None: ...

    def leave(self) -> None: ...


ALONE = SingleProcess()


class DistributedProcesses:
    """Processes joined by torch.distributed, under the addresses that torchrun leaves in the environment.

    device: `cpu` (gloo) or `cuda` (gloo for what is in memory, NCCL for what is on GPUs, one a process); anything else
    says why this process has neither. InvalidValue, in every process, unless all have the same.
    """

    def __init__(self, device: str = "cpu") -> None:
        import torch
        from torch import distributed

        self._torch, self._distributed = torch, distributed
        # The store outlives the processes under torchrun: a fault can be told through it.
        self._store, self.place, self.count = next(iter(distributed.rendezvous("env://")))
        self.first = self.place == 0
        self._try(self._compare, self._taken(device))
        self._on_gpus = device == "cuda"
        backend = "cpu:gloo,cuda:nccl" if device == "cuda" else "gloo"
        settings = {"store": self._store, "rank": self.place, "world_size": self.count, "timeout": LONGEST_WAIT}
        self._try(distributed.init_process_group, backend, **settings)

    def _taken(self, device: str) -> str:
        """`device`, this process's own GPU made the one that it uses; or why it cannot be used."""
        if device == "cuda":
            try:
                self._torch.cuda.set_device(int(os.environ.get("LOCAL_RANK", "0")))
            except RuntimeError as error:
                return f"no GPU ({str(error).splitlines()[0]})"
        return device

    def _compare(self, device: str) -> None:
        """Through the store, since processes with unlike devices could not even join."""
        self._store.set_timeout(LONGEST_WAIT)
        self._store.set(f"stylerf device {self.place}", device)
        found = [self._store.get(f"stylerf device {place}").decode() for place in range(self.count)]
        if len(set(found)) == 1 and device in ("cpu", "cuda"):
            return
        self._await_readers()
        if len(set(found)) == 1:
            raise InvalidValue(device)
        told = "; ".join(f"process {found.index(one)}: {one}" for one in dict.fromkeys(found))
        raise InvalidValue(f"processes that train together need devices of one kind, found {told}")

    def _await_readers(self) -> None:
        """Of what was found: all end now, and the first process may hold the store that the others read it from."""
        self._store.set(f"stylerf read {self.place}", "")
        if self.place == 0:
            with suppress(RuntimeError):  # one that has died meanwhile reads no more
                self._store.wait([f"stylerf read {place}" for place in range(self.count)], READING_WAIT)

    def _try(self, collective: Callable, *arguments: Any, **more: Any) -> None:
        try:
            collective(*arguments, **more)
        except RuntimeError as error:  # of gloo, NCCL and the store alike: a connection closed
            self._abort()
            raise ProcessLost(self._told_fault()) from error

    def own(self, count: int) -> slice:
        return slice(self.place * count // self.count, (self.place + 1) * count // self.count)

    def add(self, values: np.ndarray) -> None:
        self._try(self._distributed.all_reduce, self._torch.as_tensor(values))

    def add_gradients(self, buffers: np.ndarray) -> None:
        for chunk in buffers[1:]:  # in the order in which one process adds them
            buffers[0] += chunk
        buffers[1:] = 0
        self.add(buffers[0])

    def of_first(self, value: float) -> float:
        told = np.array([value])
        self.take_first(told)
        return float(told[0])

    def take_first(self, values: np.ndarray) -> None:
        self._try(self._distributed.broadcast, self._torch.as_tensor(values), 0)

    def checkpoint(self, saved: Checkpoint | None) -> Checkpoint | None:
        data, arrays = saved or (None, {})
        listed = [[name, array.dtype.str, array.shape] for name, array in arrays.items()]
        data, listed = json.loads(self.tell(json.dumps([data, listed])))
        if not self.first:
            arrays = {name: np.empty(shape, dtype) for name, dtype, shape in listed}
        for name, array in arrays.items():
            arrays[name] = np.ascontiguousarray(array)
            self.take_first(arrays[name].reshape(-1).view(np.uint8))
        return None if data is None else (data, arrays)

    def leave(self) -> None:
        self._distributed.destroy_process_group()

    def _abort(self) -> None:
        """Ends sums under way: a GPU would wait for a lost process's part before anything else is done there."""
        if self._distributed.is_initialized() and self._on_gpus:
            with suppress(RuntimeError):
                self._distributed.group.WORLD._get_backend(self._torch.device("cuda")).abort()

    def tell(self, text: str = "") -> str:
        """The first process's text; the others' own is not looked at."""
        content = np.frombuffer(text.encode(), np.uint8).copy() if self.first else None
        length = int(self.of_first(len(content) if self.first else 0))
        content = content if self.first else np.empty(length, np.uint8)
        self.take_first(content)
        return content.tobytes().decode()

    def tell_fault(self, line: str) -> None:
        """Leaves this process's fault for the first one to tell, unless another was before it."""
        try:
            self._store.compare_set("stylerf fault", "", f"process {self.place}: {line}")
        except RuntimeError:  # the first process hosted the store, and is gone
            return

    def _told_fault(self) -> str:
        try:
            if self._store.check(["stylerf fault"]):
                return self._store.get("stylerf fault").decode()
        except RuntimeError:
            pass
        return ""
