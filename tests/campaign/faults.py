"""Disks that fail: one system call of a command, or all from one on, fails; then the same command once more.

The command must end with exit code 5 and one line, or as if nothing had been (a fault that does no harm); where a read
fails, 3 and 4 count too. What stands must be sound, and the same command must end well when the disk does.
"""

import os
import shutil
import subprocess
from collections import Counter
from pathlib import Path
from random import Random
from typing import Any

from tests.campaign.ground import Ground, Stage, contents, copy_of, verified
from tests.campaign.kills import Undisturbed, differing, finished_well
from tests.campaign.tracing import Call, ended, injected, traced
from tests.stylerf_cli.nursery import Command, Nursery

# What the disk answers, to which calls.
ERRORS = {
    "full disk": (
        "ENOSPC",
        ("openat", "write", "writev", "pwrite64", "mkdir", "rename", "ftruncate", "fallocate", "fsync"),
    ),
    "quota": ("EDQUOT", ("openat", "write", "writev", "pwrite64", "mkdir")),
    "input/output error": (
        "EIO",
        ("write", "writev", "pwrite64", "fsync", "rename", "renameat2", "openat", "unlink", "mkdir"),
    ),
    "read-only disk": ("EROFS", ("openat", "mkdir", "rename", "renameat2", "unlink", "unlinkat")),
    "no permission": ("EACCES", ("openat", "mkdir", "rename", "unlink")),
    "no fsync of folders": ("EINVAL", ("fsync",)),
    "no exchange of folders": ("ENOSYS", ("renameat2",)),
    "no locks": ("ENOLCK", ("flock",)),
    "read error": ("EIO", ("read", "openat")),
    "stale handle": ("ESTALE", ("read", "openat")),
}
SLOW = "slow disk"
MOUNTED = "full tmpfs"
CLOSED = "folder without permission"
KINDS = (*ERRORS, SLOW, MOUNTED, CLOSED)
DELAY_MICROSECONDS = 30_000
ENDS_WELL_OR_OUT_OF_RESOURCES = (0, 5)


def choices(kind: str, whole: Undisturbed) -> list[Call]:
    """Return the calls of the undisturbed run that a fault of this kind can hit."""
    if kind not in ERRORS:
        return []
    names = ERRORS[kind][1]
    calls = [one for one in whole.calls if one.name in names]
    if kind in ("read error", "stale handle"):
        return [one for one in calls if not one.writes]
    if kind == "no fsync of folders":
        return [one for one in calls if _of_a_folder(one)]
    return [one for one in calls if one.writes or one.name == "flock"]


def _of_a_folder(call: Call) -> bool:
    name = call.text.partition("<")[2].partition(">")[0].rpartition("/")[2]
    return "." not in name or name.endswith(".partial")


def trial(nursery: Nursery, ground: Ground, stage: Stage, whole: Undisturbed, kind: str, seed: str) -> dict[str, Any]:
    """Run once with a fault, once without; return what happened, with an empty `fault` if all is well."""
    chance = Random(seed)
    if kind == MOUNTED:
        reported = _mounted(nursery, ground, stage, whole, chance)
    elif kind == CLOSED:
        reported = _closed(nursery, ground, stage, whole, chance)
    else:
        reported = _injected(nursery, ground, stage, whole, kind, chance)
    return {"stage": stage.name, "kind": kind, "seed": seed, **reported}


def _injected(nursery, ground: Ground, stage: Stage, whole: Undisturbed, kind: str, chance: Random) -> dict[str, Any]:
    with copy_of(stage.base, ground.folder / "trials") as work:
        if kind == SLOW:
            requested, names, moment = [f"fsync,rename:delay_enter={DELAY_MICROSECONDS}"], ("fsync", "rename"), "all"
        else:
            found = choices(kind, whole)
            if not found:
                return {"moment": "", "code": None, "fault": ""}
            call = chance.choice(found)
            # Files of libraries are opened and read too: only what writes may fail for good.
            lasting = "" if call.name in ("openat", "read") else chance.choice(("", "+"))
            requested = [f"{call.name}:error={ERRORS[kind][0]}:when={call.number}{lasting}"]
            names, moment = (call.name,), f"{call.name} {call.number}{lasting}: {call.text[:90]}"
        log = work.parent / "strace.log"
        command, tracer = traced(nursery, work.parent / "said", log, stage.command(work), requested, names)
        command.wait()
        ended(tracer)
        met = injected(log, work)
        if kind != SLOW and not any("</" in one or '"/' in one for one in met):
            return {"moment": moment, "code": None, "fault": ""}  # it came to other calls than were recorded
        mute = any("/said/" in one for one in met)  # the line itself could not be written
        return {"moment": moment, "met": len(met), **_judged(nursery, stage, work, whole, command, kind, mute)}


def _judged(
    nursery: Nursery, stage: Stage, work: Path, whole: Undisturbed, command: Command, kind: str, mute: bool = False
) -> dict[str, Any]:
    """Return code, last line and fault of a command that hit a fault, and of the rerun after it."""
    code, err = command.code, command.err
    reported = {"code": code, "line": (err.splitlines() or [""])[-1][:300]}
    allowed = ENDS_WELL_OR_OUT_OF_RESOURCES + ((3, 4) if kind in ("read error", "stale handle") else ())
    if code not in allowed:
        return reported | {"fault": f"ends with {code}: {err.strip()[:600]}"}
    if "Traceback" in err or (code and not mute and err.count("\n") != 1):
        return reported | {"fault": f"does not tell it in one line: {err.strip()[:600]}"}
    if code == 0 and (other := differing(contents(work), whole.files)):
        return reported | {"fault": f"ends well and makes another {', '.join(other[:4])}"}
    fault = verified(nursery, work) or finished_well(nursery, stage, work, whole)
    return reported | {"fault": fault}


def _mounted(nursery: Nursery, ground: Ground, stage: Stage, whole: Undisturbed, chance: Random) -> dict[str, Any]:
    """Run on a disk with space for part of what the stage writes, then for all of it."""
    with copy_of(None, ground.folder / "trials") as work:
        folder = work.parent / "disk"
        folder.mkdir()
        there = sum(path.stat().st_blocks * 512 for path in stage.base.rglob("*")) if stage.base else 0
        room = 200_000 + there + int(chance.random() * 1_500_000)
        if not _mount(folder, f"size={room}"):
            return {"moment": "no tmpfs can be mounted here", "code": None, "fault": ""}
        try:
            if stage.base:
                shutil.copytree(stage.base, folder / "work")
            said = work.parent / "said"
            command = nursery.run(said, *stage.command(folder / "work"))
            moment = f"{room} bytes, {there} of them taken"
            code, err = command.code, command.err
            reported = {"moment": moment, "code": code, "line": (err.splitlines() or [""])[-1][:300]}
            if code not in ENDS_WELL_OR_OUT_OF_RESOURCES or "Traceback" in err or (code and err.count("\n") != 1):
                return reported | {"fault": f"ends with {code}: {err.strip()[:600]}"}
            fault = verified(nursery, folder / "work", work.parent / "verify")  # the full disk has no room for output
            _mount(folder, "remount,size=256m")
            return reported | {"fault": fault or finished_well(nursery, stage, folder / "work", whole)}
        finally:
            subprocess.run(["umount", "-l", str(folder)], check=False)


def _mount(folder: Path, options: str) -> bool:
    command = ["mount", "-t", "tmpfs", "-o", options, "none", str(folder)]
    return os.geteuid() == 0 and subprocess.run(command, capture_output=True, check=False).returncode == 0


def _closed(nursery: Nursery, ground: Ground, stage: Stage, whole: Undisturbed, chance: Random) -> dict[str, Any]:
    """Run with a read-only folder in the work folder. nursery: one whose children are not privileged."""
    with copy_of(stage.base or ground.folder / "bare", ground.folder / "trials") as work:
        folders = [work, *(path for path in sorted(work.iterdir()) if path.is_dir())]
        closed = chance.choice(folders)
        closed.chmod(0o555)
        try:
            command = nursery.run(work.parent / "said", *stage.command(work))
        finally:
            closed.chmod(0o755)
        reported = _judged(nursery, stage, work, whole, command, CLOSED)
        return {"moment": str(closed.relative_to(work.parent)), **reported}


def summary(trials: list[dict[str, Any]]) -> dict[str, Any]:
    """Return counts by kind and exit code, and every fault with its seed."""
    by_kind: dict[str, Counter] = {}
    for one in trials:
        if one["code"] is not None:
            by_kind.setdefault(one["kind"], Counter())[f"exit code {one['code']}"] += 1
    return {
        "runs": sum(one["code"] is not None for one in trials),
        "by_kind": {kind: dict(sorted(codes.items())) for kind, codes in sorted(by_kind.items())},
        "faults": [one for one in trials if one["fault"]],
    }
