"""The cost of jobs: seconds, peak memory and disk, from earlier measurements and from finished stages."""

import json
import statistics
from collections import defaultdict
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from importlib.resources import files
from pathlib import Path

from schemas.errors import StylerfError
from schemas.manifest import Manifest
from schemas.work_folder import Artifact
from stages.configs.fit import budget_of
from stages.evaluation.metrics import is_number
from stages.farm.jobs import EVAL, Job

LEAST_MB = 256.0


@dataclass(frozen=True)
class Rate:
    """The cost of a rule.

    Seconds are `seconds`, plus `share` of a time budget or `step_seconds` per step, plus `frame_seconds` per frame;
    disk_mb and frame_disk_mb likewise. peak_mb: the most memory, 1 MB = 1e6 bytes.
    """

    seconds: float = 0.0
    share: float = 1.0
    step_seconds: float = 0.0
    frame_seconds: float = 0.0
    peak_mb: float = 1000.0
    disk_mb: float = 0.0
    frame_disk_mb: float = 0.0


@dataclass(frozen=True)
class Cost:
    """The cost of a job. seconds: wall time on the table's threads, including the start of the process."""

    seconds: float
    peak_mb: float
    disk_mb: float


@dataclass(frozen=True)
class Costs:
    """Rates by rule, or by rule and method. measured: how many artifacts of a table they were corrected by."""

    start_seconds: float
    rates: Mapping[str, Rate]
    source: str
    measured: int = 0

    def of(self, job: Job) -> Cost:
        """Return what a job is expected to cost."""
        rate = self.rates.get(f"{job.rule} {job.method}") or self.rates[job.rule]
        seconds = self.start_seconds + rate.seconds + rate.frame_seconds * job.frames
        if job.budget:
            time, steps = budget_of(job.budget)
            seconds += rate.share * time + rate.step_seconds * steps
        return Cost(seconds, max(rate.peak_mb, LEAST_MB), rate.disk_mb + rate.frame_disk_mb * job.frames)


def shipped_costs() -> Costs:
    """Return the costs measured for this version."""
    content = json.loads(files("stages.farm").joinpath("costs.json").read_bytes())
    rates = {rule: Rate(**rate) for rule, rate in content["rules"].items()}
    return Costs(content["start_seconds"], rates, content["from"])


def corrected(costs: Costs, out: Path, jobs: Mapping[str, Job]) -> Costs:
    """Correct the costs by the jobs of a table that are done: medians of time and disk, the maximum of memory.

    All parts of a rate are scaled alike, so that jobs with other budgets benefit too. Unreadable artifacts are left
    out.
    """
    found: dict[str, list[tuple[Job, Manifest]]] = defaultdict(list)
    for job in jobs.values():
        with suppress(StylerfError, OSError):
            manifest = Artifact(out / job.key).manifest
            if is_number(manifest.seconds) and manifest.seconds > 0:
                found[f"{job.rule} {job.method}".strip()].append((job, manifest))
    rates = dict(costs.rates)
    for rule, made in found.items():
        before = replace(costs, start_seconds=0.0)
        expected = [before.of(job) for job, _ in made]
        rate = rates.get(rule) or rates[rule.partition(" ")[0]]
        # Frames that an evaluation renders first are not in its manifest's seconds.
        scale = 1.0 if rule == EVAL else statistics.median(
            one.seconds / max(cost.seconds, 1e-3) for (_, one), cost in zip(made, expected, strict=True)
        )  # fmt: skip
        sizes = [sum(record.bytes for record in one.files) / 1e6 for _, one in made]
        disk = 1.0 if rule == EVAL else statistics.median(
            size / max(cost.disk_mb, 1e-3) for size, cost in zip(sizes, expected, strict=True)
        )  # fmt: skip
        timed = {item.name: getattr(rate, item.name) * scale for item in fields(Rate)
                 if item.name in ("seconds", "share", "step_seconds", "frame_seconds")}  # fmt: skip
        peak = max(one.peak_memory_mb for _, one in made) or rate.peak_mb
        rates[rule] = replace(
            rate, **timed, peak_mb=peak, disk_mb=rate.disk_mb * disk, frame_disk_mb=rate.frame_disk_mb * disk
        )
    return replace(costs, rates=rates, measured=sum(map(len, found.values())))
