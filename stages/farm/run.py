"""Run a table: check, plan, call Snakemake, report what failed."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from schemas.errors import CheckFailed, OutOfResources, StylerfError, UsageError
from schemas.lock import Lock
from stages.configs.farm import FarmConfig
from stages.farm.costs import Cost, Costs, corrected, shipped_costs
from stages.farm.engine import command_of, refuse_missing, run_engine
from stages.farm.folder import (
    failures,
    farm_folder,
    finished,
    forget_results,
    sweep_copies,
    write_jobs,
)
from stages.farm.jobs import Job, jobs_of
from stages.farm.plan import Plan, plan_of
from stages.farm.table import Table


class JobsFailed(CheckFailed):
    """Jobs of a table failed. details: the result of the command."""

    def __init__(self, line: str, details: dict[str, Any]) -> None:
        super().__init__(line)
        self.details = details


@dataclass(frozen=True)
class Farm:
    """A table with its jobs and what they cost."""

    table: Table
    jobs: Mapping[str, Job]
    costs: Costs

    @property
    def cost_of(self) -> dict[str, Cost]:
        """The cost of every job, by key."""
        return {key: self.costs.of(job) for key, job in self.jobs.items()}

    def plan(self, cores: int) -> Plan:
        """Plan what is not finished yet."""
        there = finished(self.table.out, self.jobs)
        return plan_of(self.jobs, self.cost_of, there, cores, self.table.threads)


def farm_of(table: Table) -> Farm:
    """Return the jobs of a table, with costs corrected by what its folder has already measured."""
    jobs = jobs_of(table)
    return Farm(table, jobs, corrected(shipped_costs(), table.out, jobs))


def planned(farm: Farm, cores: int) -> dict[str, Any]:
    """Return the plan for this number of cores as plain values."""
    plan = farm.plan(cores)
    return {
        "table": farm.table.file,
        "out": farm.table.out,
        "jobs": len(farm.jobs),
        "to_do": plan.to_do,
        "plan": asdict(plan),
        "costs": {"from": farm.costs.source, "corrected_by": farm.costs.measured},
    }


def run_table(
    farm: Farm,
    config: FarmConfig,
    cores: int,
    memory_mb: int,
    *,
    no_paths: bool = False,
    quiet: bool = False,
    report: Callable[[], dict[str, Any]] | None = None,
) -> dict[str, Any]:
    """Run the unfinished jobs; return how many are finished now, and what failed.

    Args:
        farm: the table and its jobs.
        config: where jobs run.
        cores, memory_mb: what jobs on this machine may use at once.
        no_paths: record external files by name only.
        quiet: discard Snakemake's output.
        report: writes the report over the finished jobs; not called in a dry run or without any field.

    Raises:
        JobsFailed: a job failed. Jobs that do not depend on it were run, and the report was written.
        OutOfResources: Snakemake is not installed, or another run locks the folder.
        UsageError: Snakemake could not start.
    """
    refuse_missing(config.profile)
    out = farm.table.out
    if out.exists() and not out.is_dir():
        raise UsageError(f"{out} is a file; expected the folder of the table's results")
    try:
        lock = Lock(farm_folder(out) / ".run.lock")
    except OutOfResources as error:
        if "being written by another process" not in str(error):
            raise
        holder = str(error).partition("(")[2].partition(")")[0]
        raise OutOfResources(
            f"{out} is in use by another `stylerf farm` (process {holder}); wait for it to finish, or give the table "
            "another `out`"
        ) from error
    try:
        sweep_copies(out, farm.jobs)
        write_jobs(farm.table, farm.jobs, farm.cost_of, no_paths)
        command = command_of(config, out, cores, memory_mb, farm.table.container)
        if not config.dry_run:
            forget_results(out)
        code = run_engine(command, lock, quiet)
    finally:
        lock.release()
    return _outcome(farm, config, code, report)


def _outcome(
    farm: Farm, config: FarmConfig, code: int, report: Callable[[], dict[str, Any]] | None
) -> dict[str, Any]:
    out = farm.table.out
    there = finished(out, farm.jobs)
    result: dict[str, Any] = {"table": farm.table.file, "out": out, "jobs": len(farm.jobs), "finished": len(there)}
    if config.dry_run:
        if code:
            raise UsageError(f"Snakemake could not start the run (exit code {code}); see its messages above")
        return result
    failed = failures(out, farm.jobs)
    result["failed"] = [asdict(one) for one in failed]
    if report is not None and any(farm.jobs[key].kind == "field" for key in there):
        try:
            result["report"] = report()
        except StylerfError as error:
            if not failed:
                raise
            result["report_fault"] = str(error)  # why jobs failed matters more, and is reported below
    if failed:
        blocked = len(farm.jobs) - len(there) - len(failed)
        waiting = f", {blocked} wait for them" if blocked else ""
        first = failed[0]
        raise JobsFailed(
            f"{len(failed)} of {len(farm.jobs)} jobs failed{waiting}; rerun the same command to try them again. "
            f"{first.key}: {first.why}", result,
        )  # fmt: skip
    return result
