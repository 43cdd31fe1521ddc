"""The campaign's result file: counts of every part, with seed, command, machine and what the parts do."""

import json
from pathlib import Path
from typing import Any

from benchmarks.conditions import here_and_now

PROTOCOL = """A still life of 32x32 pixels, 10 training views, one thread a command, budgets in steps.
KILLS: kill -9 at a uniformly random share of a command's processor time, and, where strace can, as its main thread
enters an openat, write, fsync, rename, unlink or mkdir on the work folder, up to three times in a row; then `stylerf
verify`, then the same command to its end: the digests of every file of every artifact must be those of an undisturbed
run, and nothing may be left of the run.
MUTANTS: real files (photos, masks, EXR, lists of poses, COLMAP, npy, TOML, camera paths, paintings, flows, weights,
every file of every kind of artifact, checkpoints) damaged by a seeded hand, bytes and structure, and read by the
command that reads them, in a process that has imported stylerf once. A fault is: a traceback, or exit code 1 for a
fault of our own; a process that dies; more than 20 s; more than 2 GB of resident memory (with --memory 1G); more or
other than one line of error; a file written outside of the folders; and a silent success: exit code 0 for a file that
the digests of a manifest or the check sums of a PNG tell to be damaged, for a field that holds NaN, or, after a
checkpoint, with another result than the undisturbed run's. Those marked resealed have a manifest that fits.
FAULTS: one system call on the work folder, or all of its kind from there on, answers with an error (strace); a tmpfs
that is too small; a folder without permission. Exit code 5 and one line are asked for, or 0 and the undisturbed result;
where a read fails 3 and 4 count too; then `verify`, and the same command without the fault as above.
CROWDS: two to eight commands begun at once in one work folder. Each must end with 0, or 5 where another one writes the
same artifact; then all are run alone: artifacts must be those of commands one after the other."""


def write(out: Path, command: str, seed: int, parts: dict[str, Any], seconds: dict[str, float], strace: bool) -> None:
    """Return the result. parts: each part's summary, by name."""
    report = {
        "command": command,
        "protocol": PROTOCOL,
        **here_and_now(),
        "seed": seed,
        "strace": strace,
        "seconds": {name: round(value) for name, value in seconds.items()},
        **parts,
    }
    out.write_text(json.dumps(report, indent=1, ensure_ascii=False) + "\n")


def line_of(name: str, part: dict[str, Any]) -> str:
    """Return one line about a part, for progress."""
    counts = ", ".join(f"{key} {value}" for key, value in part.items() if isinstance(value, int | float))
    return f"{name}: {counts}, faults {len(part['faults'])}"
