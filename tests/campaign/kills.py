"""kill -9: at random shares of a command's time, and as it enters a system call; then the same command once more.

After each kill `stylerf verify` must find what stands sound, and the same command must end well with the very files
that it makes undisturbed. A run may be killed several times before it is let go.
"""

import signal
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any

from schemas.errors import OutOfResources
from tests.campaign.ground import Ground, Stage, contents, copy_of, leftovers, verified
from tests.campaign.tracing import calls_on, ended, traced
from tests.stylerf_cli.nursery import Command, Nursery

KILLED_AT = ("openat", "write", "writev", "fsync", "rename", "renameat2", "unlink", "unlinkat", "mkdir")
MOST_IN_A_ROW = 3
FOLLOWED_EVERY_SECONDS = 0.002
CHILD_KILLED = "structure from motion was killed"


@dataclass
class Undisturbed:
    """What a stage makes when nothing disturbs it, its processor time in seconds, and its system calls."""

    files: dict[str, dict[str, str]]
    seconds: float
    calls: list = field(default_factory=list)


def undisturbed(nursery: Nursery, ground: Ground, stage: Stage, strace: bool) -> Undisturbed:
    """Runs a stage twice, the second time under strace where that is there; both must make the same."""
    whole, again = _run(nursery, ground, stage, False), _run(nursery, ground, stage, strace)
    other = differing(whole.files, again.files)
    assert not other, f"{stage.name} makes other files the second time: {other}"
    return Undisturbed(whole.files, whole.seconds, again.calls)


def _run(nursery: Nursery, ground: Ground, stage: Stage, strace: bool) -> Undisturbed:
    with copy_of(stage.base, ground.folder / "trials") as work:
        log, said, words = work.parent / "strace.log", work.parent / "said", stage.command(work)
        command, tracer = traced(nursery, said, log, words, ()) if strace else (nursery.start(said, *words), None)
        used = 0.0
        while command.poll(FOLLOWED_EVERY_SECONDS) is None:
            used = max(used, command.cpu_seconds())
        if tracer is not None:
            ended(tracer)
        assert command.code == 0, f"{stage.name}: {command.err}"
        return Undisturbed(contents(work), used, calls_on(log, command.pid, work) if strace else [])


def differing(one: dict, other: dict) -> list[str]:
    """Files of artifacts that are not the same."""
    return sorted(
        f"{name}/{path}"
        for name in one.keys() | other.keys()
        for path in one.get(name, {}).keys() | other.get(name, {}).keys()
        if one.get(name, {}).get(path) != other.get(name, {}).get(path)
    )


def trial(
    nursery: Nursery, ground: Ground, stage: Stage, whole: Undisturbed, seed: str, by_call: bool
) -> dict[str, Any]:
    """One run, killed up to MOST_IN_A_ROW times, then let go: what happened; `fault` is empty where all is well."""
    chance = Random(seed)
    wanted = chance.choice((1, 1, 1, 2, MOST_IN_A_ROW))
    reported: dict[str, Any] = {"stage": stage.name, "seed": seed, "moments": [], "kills": 0, "fault": ""}
    with copy_of(stage.base, ground.folder / "trials") as work:
        for _ in range(wanted):
            if by_call:
                moment, command = killed_at_a_call(nursery, stage, work, whole, chance)
            else:
                moment, command = killed_in_time(nursery, stage, work, whole, chance)
            if command.code == 0:  # it was quicker than its moment
                break
            if by_call and command.code == OutOfResources.exit_code and CHILD_KILLED in command.err:
                # strace follows the child of structure from motion too; the parent reports its death.
                moment += " in its child"
            elif command.code != -signal.SIGKILL:
                reported["fault"] = f"ends with {command.code} before it is killed: {command.err.strip()}"
                return reported
            reported["moments"].append(moment)
            reported["kills"] += 1
            if fault := verified(nursery, work):
                reported["fault"] = fault
                return reported
        reported["fault"] = finished_well(nursery, stage, work, whole)
    return reported


def finished_well(nursery: Nursery, stage: Stage, work: Path, whole: Undisturbed) -> str:
    """Runs the stage's command to its end: what is wrong with it or with what it made; empty where nothing is."""
    last = nursery.run(work.parent / "said", *stage.command(work))
    if last.code != 0:
        return f"the same command then ends with {last.code}: {last.err.strip()}"
    if fault := verified(nursery, work):
        return fault
    if other := differing(contents(work), whole.files):
        return f"the same command then makes another {', '.join(other[:4])}"
    left = leftovers(work)
    return f"the same command then leaves {', '.join(left[:4])}" if left else ""


def killed_in_time(
    nursery: Nursery, stage: Stage, work: Path, whole: Undisturbed, chance: Random
) -> tuple[str, Command]:
    """After a share of the undisturbed run's processor time, even over all of it."""
    share = chance.random()
    command = nursery.start(work.parent / "said", *stage.command(work))
    while command.poll(FOLLOWED_EVERY_SECONDS) is None and command.cpu_seconds() < share * whole.seconds:
        pass
    command.send(signal.SIGKILL)
    command.wait()
    return f"{share:.3f} of its time", command


def killed_at_a_call(
    nursery: Nursery, stage: Stage, work: Path, whole: Undisturbed, chance: Random
) -> tuple[str, Command]:
    """As the main thread enters one of the calls that the undisturbed run makes on its work folder."""
    by_name = {name: [one for one in whole.calls if one.name == name and one.writes] for name in KILLED_AT}
    name = chance.choice([name for name, calls in by_name.items() if calls])
    call = chance.choice(by_name[name])
    log = work.parent / "strace.log"
    requested = [f"{name}:signal=KILL:when={call.number}"]
    command, tracer = traced(nursery, work.parent / "said", log, stage.command(work), requested, (name,))
    command.wait()
    ended(tracer)
    return f"{name} {call.number}: {call.text[:80]}", command


def summary(trials: list[dict[str, Any]]) -> dict[str, Any]:
    """Counts by stage and kind of moment, and every fault with its seed."""
    kills = Counter()
    for one in trials:
        kills[one["stage"]] += one["kills"]
    return {
        "kills": sum(kills.values()),
        "by_stage": dict(sorted(kills.items())),
        "at_system_calls": sum(one["kills"] for one in trials if one["by_call"]),
        "runs": len(trials),
        "runs_that_ended_before_their_moment": sum(one["kills"] == 0 for one in trials),
        "faults": [one for one in trials if one["fault"]],
    }


def run(nursery: Nursery, ground: Ground, wholes: dict[str, Undisturbed], names: list[str], seed: str) -> list[dict]:
    """One trial for each stage named, every other one at a system call where they were recorded."""
    trials = []
    for number, name in enumerate(names):
        stage, by_call = ground.stages[name], number % 2 == 1 and bool(wholes[name].calls)
        begun = time.monotonic()
        reported = trial(nursery, ground, stage, wholes[name], f"{seed}/{name}/{number}", by_call)
        trials.append(reported | {"by_call": by_call, "seconds": round(time.monotonic() - begun, 2)})
    return trials
