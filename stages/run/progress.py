"""How a stage tells what it is doing; the front door decides how that looks."""

from dataclasses import dataclass
from typing import Any, Protocol

from stylerf.training.common.process_group import ALONE


class Progress(Protocol):
    """Told by stages and training loops; never asked anything."""

    def start(self, label: str, total: float | None = None, unit: str = "step") -> None:
        """Open a bar of `total` units (None: unknown length)."""

    def update(self, done: float, note: str = "") -> None:
        """`done` units of the open bar are finished; `note` is the present quality, such as '27.1 dB'."""

    def finish(self) -> None:
        """Close the open bar."""

    def say(self, text: str) -> None:
        """One line the user should read: a choice made, a fallback taken, files skipped."""


class Silent:
    """Progress that goes nowhere, for tests and the Python API."""

    def start(self, label: str, total: float | None = None, unit: str = "step") -> None: ...

    def update(self, done: float, note: str = "") -> None: ...

    def finish(self) -> None: ...

    def say(self, text: str) -> None: ...


@dataclass(frozen=True)
class Context:
    """What every stage is run with beside its inputs and options; nothing of it but the seed changes a result.

    memory: bytes that the process may take, 0: most of what is free. ranks: the processes that run a stage together.
    anew: nothing that was made before is to be taken for what is made now. no_paths: files from outside are
    told by their names alone, without their folders.
    """

    seed: int = 0
    device: str = "cpu"
    threads: int = 2
    memory: int = 0
    anew: bool = False
    no_paths: bool = False
    ranks: Any = ALONE
    progress: Any = Silent()
