"""`stylerf farm TABLE`: scenes x styles x methods x seeds of one table, as jobs of Snakemake."""

from argparse import Namespace
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from stages.configs.farm import FarmConfig
from stylerf_cli.arguments import Parser, build_config
from stylerf_cli.session import Session

CONFIG = FarmConfig
NAMELESS = "the table names its artifacts"
MOST_NAMED = 20  # failed jobs in the output; --json lists all


def add_arguments(parser: Parser) -> None:
    """TABLE."""
    parser.add_argument("table", metavar="TABLE", type=Path, help="the YAML file (docs/how-to/many-scenes.md)")


def build(config: type, options: Mapping[str, Any], where: str, others: tuple[type, ...] = ()) -> Any:
    """Build the config of a verb from a mapping of the table; UsageError for what the command line would reject."""
    return build_config(config, Namespace(), dict(options), where, others)


def run(args: Any, session: Session) -> dict[str, Any]:
    """Return the plan, or how many jobs are finished, what failed, and the report."""
    from stages.farm.run import JobsFailed, farm_of, planned, run_table
    from stages.farm.table import TableFaults, read_table
    from stages.pipeline.resources import usable_threads
    from stages.run.memory import free

    _refuse_common(args)
    config = session.config
    try:
        table = read_table(args.table, build)
    except TableFaults as error:
        for fault in error.faults[1:]:
            session.say(f"{args.table}: {fault}")
        raise
    farm = farm_of(table)
    cores = config.cores or usable_threads()
    plan = planned(farm, cores)
    lines = plan_lines(plan)
    if config.plan:
        return session.emit(plan, lines)
    for line in lines:
        session.say(line)
    memory = session.common.memory or int(free() * 0.75)

    def report() -> dict[str, Any]:
        from stages.farm.report import written_report

        return written_report(table)

    try:
        result = run_table(
            farm, config, cores, memory // 10**6, no_paths=args.no_paths, quiet=args.quiet, report=report
        )
    except JobsFailed as error:
        for one in error.details["failed"][1:MOST_NAMED]:
            waiting = f" ({one['blocked']} jobs wait for it)" if one["blocked"] else ""
            session.say(f"{one['key']}: {one['why']}{waiting}")
        if "report" in error.details:
            session.say(f"report on the finished jobs: {error.details['report']['page']}")
        raise
    words = [f"{result['finished']} of {result['jobs']} jobs finished in {result['out']}"]
    if "report" in result:
        words.append(f"report: {result['report']['page']}")
    return session.emit(result, words)


def _refuse_common(args: Any) -> None:
    from schemas.errors import UsageError

    for flag, why in (
        ("seed", "the table lists seeds"), ("device", "the table names the device"),
        ("threads", "the table sets the threads of a job; --cores limits all jobs"), ("force", "delete artifacts to "
        "make them again"), ("only", "every job of a table runs its own stage only"),
    ):  # fmt: skip
        if getattr(args, flag) not in (None, False):
            raise UsageError(f"--{flag} has no effect here: {why}; leave it out")


def plan_lines(plan: dict[str, Any]) -> list[str]:
    """One line per rule, then hours and disk space."""
    content = plan["plan"]
    lines = [f"{plan['to_do']} of {plan['jobs']} jobs to do in {plan['out']}:"]
    for rule in content["rules"]:
        todo = rule["jobs"] - rule["finished"]
        cost = f"{_time(rule['seconds'])}, up to {rule['peak_mb']:.0f} MB each, {_size(rule['disk_mb'])} of disk"
        lines.append(f"  {rule['rule']:<8} {todo:>6}" + (f"  {cost}" if todo else "  all finished"))
    if plan["to_do"]:
        lines.append(
            f"about {_time(content['wall_seconds'])} on {content['cores']} cores, {content['threads']} threads a job; "
            f"at least {_time(content['longest_seconds'])} on any number of such cores; {_size(content['disk_mb'])} "
            "of disk"
        )
        costs = plan["costs"]
        source = f"{costs['corrected_by']} artifacts of this table" if costs["corrected_by"] else costs["from"]
        lines.append(f"priced by {source}")
    return lines


def _time(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    if seconds < 5400:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h" if seconds < 3600 * 100 else f"{seconds / 3600:.0f} h"


def _size(megabytes: float) -> str:
    return f"{megabytes / 1000:.1f} GB" if megabytes >= 1000 else f"{megabytes:.0f} MB"
