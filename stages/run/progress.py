"""How stages report progress, and the context they run in."""

from dataclasses import dataclass
from typing import Protocol

from stylerf.training.common.process_group import SINGLE_PROCESS, ProcessGroup


class Progress(Protocol):
    """Receives progress from stages and training loops."""

    def start(self, label: str, total: float | None = None, unit: str = "step") -> None:
        """Open a bar of `total` units, None if the length is unknown."""

    def update(self, done: float, note: str = "") -> None:
        """Report that `done` units are finished. note: the current quality, such as '27.1 dB'."""

    def finish(self) -> None:
        """Close the open bar."""

    def say(self, text: str) -> None:
        """Show the user one line: a choice, a fallback, skipped files."""


class Silent:
    """Discards progress."""

    def start(self, label: str, total: float | None = None, unit: str = "step") -> None: ...

    def update(self, done: float, note: str = "") -> None: ...

    def finish(self) -> None: ...

    def say(self, text: str) -> None: ...


@dataclass(frozen=True)
class Context:
    """What a stage runs with besides inputs and options. Only the seed affects results.

    device: `cpu` or `cuda`. memory: bytes that the process may use, 0 for most of what is free. rebuild: reuse nothing
    from earlier runs. no_paths: record files outside the work folder by name only. processes: the processes that run a
    stage together.
    """

    seed: int = 0
    device: str = "cpu"
    threads: int = 2
    memory: int = 0
    rebuild: bool = False
    no_paths: bool = False
    processes: ProcessGroup = SINGLE_PROCESS
    progress: Progress = Silent()
