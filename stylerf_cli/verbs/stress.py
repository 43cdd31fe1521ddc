"""`stylerf stress WORK`: methods under faults, over several seeds: where they fail, what a change made worse."""

from pathlib import Path

from schemas.errors import ArtifactStale, BadInput, CheckFailed, UsageError
from stages.configs.stress import StressConfig

NAME = "stress"
HELP = "run methods under faults of photos, poses and paintings: how often each succeeds, a heat map, a baseline"
CONFIG = StressConfig
NAMELESS = "a stress writes no artifact in WORK"
FOLDER = "stress"
BASELINE = "baseline.json"
LOCK = ".runs.lock"  # two commands at once would delete each other's work folders


class Worse(CheckFailed):
    """Some cell is worse than in the baseline, or none is in both; `details`: what the verb would have returned."""

    def __init__(self, line: str, details: dict) -> None:
        super().__init__(line)
        self.details = details


def add_arguments(parser) -> None:
    """WORK, --baseline, --write-baseline."""
    parser.add_argument("work", metavar="WORK", help="a work folder with a scene")
    parser.add_argument(
        "--baseline", metavar="FILE", type=Path, help="hold the cells against this file; exit code 1 where one is worse"
    )
    parser.add_argument(
        "--write-baseline",
        metavar="FILE",
        type=Path,
        nargs="?",
        const=True,
        help=f"write the cells as a baseline (FILE: WORK/{FOLDER}/{BASELINE})",
    )


def run(args, session) -> dict:
    """Writes stress.json, cells.csv, runs.csv, stress.html, charts/; Worse where a baseline fails, after all of it.

    A verb without an artifact of its own: what it runs lies in work folders below WORK/stress/works.
    """
    from schemas.canonical_json import digest_of
    from schemas.lock import Lock
    from stages.pipeline.prerequisites import scene_of_work
    from stages.stress.baseline import read_baseline
    from stages.stress.trials import Stress

    scene = scene_of_work(session)
    root = session.work.root / FOLDER
    stress = Stress(session, session.config, scene, root)
    if not any(True for _ in stress.trials()):
        raise UsageError("no method that was asked for faces any of these faults: a fit never sees a painting")
    # By its files, not by where they came from: a baseline is to hold on another machine.
    content = digest_of([(record.path, record.sha256) for record in scene.manifest.files])
    conditions = stress.conditions | {"seed": session.common.seed, "scene": content}
    kept = root / BASELINE if args.write_baseline is True else args.write_baseline
    if args.baseline and kept and args.baseline.resolve() == kept.resolve():
        raise UsageError(
            f"--baseline and --write-baseline name one file, {kept}: what is worse would pass the next time; give two"
        )
    # Refused before hours of work, not after them.
    before = read_baseline(args.baseline, conditions) if args.baseline else None
    if before is not None and {trial.cell for trial in stress.trials()}.isdisjoint(
        (cell["method"], cell["fault"]) for cell in before
    ):
        raise UsageError(
            f"--baseline {args.baseline} holds no cell of these methods, faults and remedies; give those it was made "
            "with, or write it anew"
        )
    if session.only:  # runs nothing and deletes nothing: what another process has made so far may be looked at
        return _results(stress, conditions, before, kept, args.baseline)
    lock = Lock(root / LOCK, "add --only to see what stands")
    try:
        return _results(stress, conditions, before, kept, args.baseline)
    finally:
        lock.release()


def _results(stress, conditions: dict, before: list[dict] | None, kept: Path | None, baseline: Path | None) -> dict:
    """The runs, and all that is written of them. before: cells of the file `baseline`. kept: where to write another."""
    from dataclasses import asdict

    from schemas.atomic_write import write_bytes, write_json
    from stages.evaluation.metrics import write_csv
    from stages.stress.baseline import compared, write_baseline
    from stages.stress.heat_map import heat_map
    from stages.stress.page import build_page, cell_rows, run_rows
    from stages.stress.success_rates import cells_of
    from stages.stress.trials import WORST

    session, root = stress.session, stress.root
    outcomes = stress.run(session.only, session.force)
    if not outcomes:
        if stress.missing:
            raise BadInput(next(iter(stress.missing.values())))
        raise ArtifactStale(f"no run of this stress stands in {root}; leave --only out to make them")
    cells = cells_of(outcomes)
    held = None if before is None else compared(before, cells)
    chart = heat_map(cells)
    write_bytes(root / "charts" / "heat_map.svg", chart.svg.encode())
    write_bytes(root / "charts" / "heat_map.png", chart.png)
    write_csv(root / "cells.csv", cell_rows(cells))
    write_csv(root / "runs.csv", run_rows(outcomes))
    missing = list(stress.missing.items())
    told_of = {"work": session.work.root, **conditions}
    write_bytes(root / "stress.html", build_page(cells, chart, told_of, missing, held, root / WORST).encode())
    told = {
        "conditions": conditions,
        "cells": [cell.as_json() for cell in cells],
        "missing": [{"fault": name, "why": why} for name, why in missing],
        "baseline": None if held is None else asdict(held),
    }
    write_json(root / "stress.json", told)
    if kept:
        write_baseline(kept, cells, conditions)
    result = {"page": root / "stress.html", "heat_map": root / "charts" / "heat_map.svg", **told}
    if held is not None and held.worse:
        for line in held.worse[1:]:
            session.say(line)
        more = f" ({len(held.worse)} cells are worse than in {baseline})"
        raise Worse(held.worse[0] + more, result)
    if held is not None and not held.matched:
        raise Worse(f"no cell could be compared with {baseline} ({held.unmatched[0]})", result)
    return session.emit(result, words_of(result))


def words_of(result: dict) -> list[str]:
    """One line a cell, failing ones with the reason, then what was left out and what the baseline says."""
    lines = []
    for cell in result["cells"]:
        score = "no picture" if cell["median"] is None else f"{cell['median']:.3g}"
        spread = "" if cell["spread"] is None else f" +- {cell['spread']:.2g}"
        why = f": {cell['whys'][0]}" if cell["whys"] else ""
        mark = " " if cell["successes"] == cell["count"] else "!"
        where = f"{cell['fault']:<14} {cell['method']:<22}"
        lines.append(f"{mark} {where} {cell['successes']} of {cell['count']}, {score}{spread}{why}")
    lines += [f"left out: {one['fault']}. {one['why']}" for one in result["missing"]]
    if result["baseline"] is not None:
        held = result["baseline"]
        lines += [f"better: {line}" for line in held["better"]]
        lines += [f"not compared: {line}" for line in held["unmatched"]]
        lines.append(f"no cell of {held['matched']} compared is worse than in the baseline")
    return [*lines, f"page: {result['page']}"]
