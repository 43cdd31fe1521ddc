"""One command run by several processes under torchrun: the first leads and writes, the others follow.

    torchrun --nproc-per-node 2 --no-python stylerf fit WORK

Before a stage the leader announces whether it runs, and afterwards the name of its artifact. Followers run the same
stage on their share of the rays and write nothing.
"""

import os
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from schemas.errors import OutOfResources, UsageError
from stylerf.errors import InvalidValue, ProcessLost

if TYPE_CHECKING:  # `stylerf --help` must not wait for numpy
    from stages.run.runner import Run
    from stylerf.training.common.process_group import ProcessGroup

P = ParamSpec("P")
T = TypeVar("T")

VERBS = ("fit", "finetune")
RUN = "\n"  # announces a run; cannot be an artifact's name


def launched() -> int:
    """Return the number of processes that torchrun (or a similar launcher) started this command in, 1 without one."""
    try:
        return int(os.environ.get("WORLD_SIZE", "1")) if "RANK" in os.environ else 1
    except ValueError:
        return 1


def prints() -> bool:
    """Return whether this process is the one that prints."""
    return launched() == 1 or os.environ["RANK"] == "0"


def join(verb: str, device: Callable[[], str]) -> "ProcessGroup":
    """Join the processes launched for `verb`.

    Args:
        device: returns the device of this process, or raises UsageError if it has none.

    Raises:
        UsageError: the verb cannot run in several processes, or (in every process) their devices differ.
    """
    from stylerf.training.common.process_group import SINGLE_PROCESS, DistributedProcesses

    if launched() == 1:
        return SINGLE_PROCESS
    if verb not in VERBS:
        raise UsageError(
            f"{verb} runs in one process; start it without torchrun ({' and '.join(VERBS)} run in several)"
        )
    try:
        found = device()
    except UsageError as error:
        # Every process must still reach the comparison, or the others would wait for it.
        found = str(error)
    try:
        return _reporting_loss(DistributedProcesses, found)
    except InvalidValue as error:
        raise UsageError(str(error)) from error


def lead(processes: "ProcessGroup", run: "Run", parallel: bool) -> "Run":
    """Wrap a stage's `run` so that the followers join it, if it is `parallel`."""

    def run_led(*arguments: Any) -> dict[str, Any]:
        if parallel:
            # Announced when the leader really runs: with the lock taken, and the artifact not up to date.
            _reporting_loss(processes.tell, RUN)
        return _reporting_loss(run, *arguments)

    return run_led


def release(processes: "ProcessGroup", name: str) -> None:
    """Send the followers the name of the artifact that the stage made, so that they continue."""
    _reporting_loss(processes.tell, name)


def follow(processes: "ProcessGroup", run: "Run", inputs: Any, config: Any, context: Any, root: Path) -> str:
    """Join the stage if the leader runs it; return the name of the artifact."""
    # A follower writes no named files; a stage may keep unnamed files for its own run in the work folder.
    partial: Any = SimpleNamespace(folder=root, path=None, checkpoint=None)
    while (word := processes.tell()) == RUN:
        run(inputs, config, partial, context)
    return word


def agree(processes: "ProcessGroup", find: Callable[[], str]) -> str:
    """Return the name that `find` returns in the first process.

    Processes must not look on their own: by the time one does, the first may have made the next artifact.
    """
    if processes.count == 1:
        return find()
    return _reporting_loss(processes.tell, find() if processes.first else "")


def leave_fault(processes: "ProcessGroup", error: BaseException) -> None:
    """Pass a fault of a follower, which must not print, to the first process. A lost process is not passed on."""
    if not processes.first and not isinstance(error, (ProcessLost, KeyboardInterrupt)):
        processes.tell_fault(" ".join(f"{type(error).__name__}: {error}".split())[:500])


def _reporting_loss(function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
    try:
        return function(*args, **kwargs)
    except ProcessLost as error:
        why = f" ({error})" if str(error) else ""
        raise OutOfResources(
            f"another process of this run has ended{why}; rerun the same command to resume from the last checkpoint"
        ) from error
