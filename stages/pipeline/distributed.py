"""One command run by several processes, started by torchrun: the first leads, speaks and writes, the others follow it.

    torchrun --nproc-per-node 2 --no-python stylerf fit WORK

Before a stage the first process says whether it runs; after it, under which name its artifact stands. The others run
what it runs, on their part of the rays, and write nothing.
"""

import os
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from schemas.errors import OutOfResources, UsageError
from stylerf.errors import InvalidValue, ProcessLost

VERBS = ("fit", "finetune")
RUN = "\n"  # no artifact is named so


def launched() -> int:
    """Number of processes that torchrun (or its like) has started this command in; 1 without it."""
    try:
        return int(os.environ.get("WORLD_SIZE", "1")) if "RANK" in os.environ else 1
    except ValueError:
        return 1


def speaks() -> bool:
    """Whether this process is the one that prints."""
    return launched() == 1 or os.environ["RANK"] == "0"


def joined(verb: str, device: Callable[[], str]) -> Any:
    """This process's place among those started together; UsageError for a verb that one process runs.

    device: what this process computes on. Where it has nothing to compute on, or something else than the others, all of
    them are told so, UsageError.
    """
    from stylerf.training.common.process_group import ALONE, DistributedProcesses  # late: main must not wait for numpy

    if launched() == 1:
        return ALONE
    if verb not in VERBS:
        raise UsageError(
            f"{verb} runs in one process; start it without torchrun ({' and '.join(VERBS)} run in several)"
        )
    try:
        found = device()
    except UsageError as error:
        found = str(error)
    try:
        return _told(DistributedProcesses, found)
    except InvalidValue as error:
        raise UsageError(str(error)) from error


def led(ranks: Any, run: Any, parallel: bool) -> Any:
    """The stage's run, which the other processes join where it is one for several."""

    def run_led(*arguments: Any) -> dict:
        if parallel:
            _told(ranks.tell, RUN)
        return _told(run, *arguments)

    return run_led


def release(ranks: Any, name: str) -> None:
    """Lets the other processes go on, with the stage's artifact."""
    _told(ranks.tell, name)


def follow(ranks: Any, session: Any, spec: Any, run: Any, inputs: dict[str, Any], config: Any) -> Any:
    """The part of a process that does not lead: joins the stage if it is run, and gives the artifact that it made."""
    # What a stage may keep for its own run only, beside the work folder: nothing with a name.
    partial = SimpleNamespace(folder=session.work.root, path=None, checkpoint=None)
    while (word := ranks.tell()) == RUN:
        run(inputs, config, partial, session.context)
    return session.work.get(spec.writes, word)


def agreed(session: Any, kind: str, find: Callable[[], Any]) -> Any:
    """The artifact of that kind that `find` gives, or None: as the first of several processes finds it.

    By the time that another looks, the first may have made the next one already.
    """
    if session.ranks.count == 1:
        return find()
    found = find() if session.ranks.first else None
    name = _told(session.ranks.tell, found.name if found else "")
    return session.work.get(kind, name) if name else None


def leave_fault(ranks: Any, error: BaseException) -> None:
    """A fault of a process that must not speak, for the first one to tell; that another was lost is none of its own."""
    if not ranks.first and not isinstance(error, (ProcessLost, KeyboardInterrupt)):
        ranks.tell_fault(" ".join(f"{type(error).__name__}: {error}".split())[:500])


def _told(function: Any, *arguments: Any) -> Any:
    """What a function returns; a process that was lost meanwhile is told in words that say what to do."""
    try:
        return function(*arguments)
    except ProcessLost as error:
        why = f" ({error})" if str(error) else ""
        raise OutOfResources(
            f"another process of this run has ended{why}; what was saved last stands, the same command goes on from it"
        ) from error
