"""The folder of a table: what is written to it before Snakemake runs and read from it afterwards.

    OUT/<scene>/                   the work folder of a scene
    OUT/farm/jobs.json             the jobs, as the Snakefile reads them
    OUT/farm/frames.toml           options of the frames that evaluations render
    OUT/farm/manifests/KEY.json    copies of the manifests of finished artifacts: Snakemake's outputs
    OUT/farm/results/KEY.json      what the last attempt of a job printed: figures, or its error
    OUT/farm/logs/KEY.log          its messages
"""

import math
import os
import shlex
import shutil
import sys
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from schemas.atomic_write import write_bytes, write_json
from schemas.errors import BadInput
from schemas.safe_names import printable
from schemas.safe_reading import read_json
from stages.farm.costs import Cost
from stages.farm.jobs import FRAMES, Job
from stages.farm.table import Table

JOBS = "jobs.json"
PROGRAM = "STYLERF"  # environment variable that names another program, as for workflows/scene.sh
THIS = [sys.executable, "-P", "-m", "stylerf_cli.main"]  # -P: the folder of a scene called `stages` is not a package
RUNTIME_FACTOR = 3.0  # of the expected seconds, until a scheduler may end a job
MEMORY_FACTOR = 1.5  # of the largest peak measured
LARGEST_RESULT = 4 << 20  # bytes
LAST = 2000  # characters of a log that may hold the reason of a failure


@dataclass(frozen=True)
class Failure:
    """A job that failed, and how many other jobs it blocks."""

    key: str
    why: str
    blocked: int


def farm_folder(out: Path) -> Path:
    """Return the folder of the files about jobs."""
    return out / "farm"


def copy_of(out: Path, key: str) -> Path:
    """Return where the copy of an artifact's manifest is."""
    return farm_folder(out) / "manifests" / f"{key}.json"


def finished(out: Path, jobs: Mapping[str, Job]) -> set[str]:
    """Return the keys of the jobs whose artifacts are finished; nothing is written."""
    return {key for key, job in jobs.items() if _stands(out, job)}


def sweep_copies(out: Path, jobs: Mapping[str, Job]) -> None:
    """Delete copies of manifests whose artifacts were deleted or rebuilt manually, so that their jobs run again."""
    for key, job in jobs.items():
        if not _stands(out, job):
            copy_of(out, key).unlink(missing_ok=True)


def forget_results(out: Path) -> None:
    """Delete the results and logs of earlier runs, so that failures are those of this run."""
    shutil.rmtree(farm_folder(out) / "results", ignore_errors=True)


def _stands(out: Path, job: Job) -> bool:
    try:
        return copy_of(out, job.key).read_bytes() == (out / job.manifest).read_bytes()
    except OSError:
        return False


def write_jobs(table: Table, jobs: Mapping[str, Job], costs: Mapping[str, Cost], no_paths: bool) -> None:
    """Write farm/jobs.json, which names threads, memory, minutes and disk space of every job."""
    program = ["stylerf"] if table.container else shlex.split(os.environ.get(PROGRAM, "")) or THIS
    more = ["--no-paths"] if no_paths else []
    content = {
        "threads": table.threads,
        "gpu": table.device == "cuda",
        "container": table.container,
        "jobs": {
            key: {
                "rule": job.rule,
                "command": shlex.join([*program, *job.argv, *more]),
                "manifest": job.manifest,
                "after": list(job.after),
                # Without missing ones: their job reports the error, while Snakemake would reject the whole table.
                "files": [str(file) for file in job.files if file.exists()],
                "mem_mb": math.ceil(costs[key].peak_mb * MEMORY_FACTOR),
                "minutes": math.ceil(costs[key].seconds * RUNTIME_FACTOR / 60) + 5,
                "disk_mb": math.ceil(costs[key].disk_mb),
            }
            for key, job in jobs.items()
        },
    }
    # As for renders: which regions there are depends on the edits that happen to be finished.
    write_bytes(table.out / FRAMES, b"[render]\nregions = false\n")
    write_json(farm_folder(table.out) / JOBS, content)


def failures(out: Path, jobs: Mapping[str, Job]) -> list[Failure]:
    """Return the unfinished jobs whose prerequisites are all finished, with the reason that they gave."""
    there = finished(out, jobs)
    behind: dict[str, set[str]] = {}
    for key, job in jobs.items():  # each after those that it waits for
        if key not in there:
            missing = [one for one in job.after if one not in there]
            behind[key] = set().union(*(behind[one] for one in missing)) if missing else {key}
    return [
        Failure(key, _why(out, key), sum(key in roots for one, roots in behind.items() if one != key))
        for key, roots in behind.items()
        if roots == {key}
    ]


def _why(out: Path, key: str) -> str:
    with suppress(OSError, BadInput):
        said = read_json(farm_folder(out) / "results" / f"{key}.json", limit=LARGEST_RESULT)
        if isinstance(said, dict) and isinstance(said.get("error"), str):
            return printable(said["error"])
    log = farm_folder(out) / "logs" / f"{key}.log"
    with suppress(OSError):
        lines = log.read_bytes()[-LAST:].decode(errors="replace").splitlines()
        if lines and "error" in lines[-1].lower():
            return printable(lines[-1])
        return f"it was killed or lost; see {log}"
    return "it never started; see Snakemake's messages"
