"""Run methods under faults, write the pages and tables, and compare the cells with a baseline."""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from schemas.errors import ArtifactStale, BadInput, CheckFailed, UsageError
from schemas.work_folder import Artifact
from stages.configs.stress import StressConfig
from stages.pipeline.prerequisites import scene_of_work
from stages.pipeline.stage_runner import StageRunner

if TYPE_CHECKING:  # the trials import every stage
    from stages.stress.trials import Stress

FOLDER = "stress"
BASELINE = "baseline.json"
LOCK = ".runs.lock"  # two commands at once would delete each other's work folders


class Regression(CheckFailed):
    """A cell is worse than in the baseline, or no cell is in both."""


@dataclass(frozen=True)
class Baselines:
    """Baseline files. read: to compare with. write: to write, None for none."""

    read: Path | None = None
    write: Path | None = None


def stressed(runner: StageRunner, config: StressConfig, baselines: Baselines, force: bool) -> dict[str, Any]:
    """Write stress.json, cells.csv, runs.csv, stress.html and charts/ to WORK/stress; return the contents of
    stress.json.

    Trials run in work folders below WORK/stress/works, never in WORK. With `runner.only` nothing is run: existing
    results, perhaps of a command still running, are reported.

    Raises:
        Regression: a cell is worse than in the baseline; raised after everything is written.
    """
    from schemas.atomic_write import sweeping
    from schemas.lock import Lock
    from stages.stress.baseline import read_baseline
    from stages.stress.trials import WORST, Stress

    scene = scene_of_work(runner.work)
    root = runner.work.root / FOLDER
    stress = Stress(runner.context, config, scene, root)
    cells = {trial.cell for trial in stress.trials()}
    if not cells:
        raise UsageError("none of these faults affects any of these methods: a fit uses no style image")
    conditions = stress.conditions | {"seed": runner.seed, "scene": _content_digest(scene)}
    if baselines.read and baselines.write and baselines.read.resolve() == baselines.write.resolve():
        raise UsageError(
            f"--baseline and --write-baseline name the same file, {baselines.write}: a regression would pass the next "
            "time; give two files"
        )
    # Reject a baseline that does not match before hours of work, not after them.
    before = read_baseline(baselines.read, conditions) if baselines.read else None
    if before is not None and cells.isdisjoint((cell["method"], cell["fault"]) for cell in before):
        raise UsageError(
            f"--baseline {baselines.read} contains no cells for these methods, faults and remedies; use those it was "
            "made with, or write a new one"
        )
    with ExitStack() as stack:
        if not runner.only:
            lock = Lock(root / LOCK, "add --only to see the results so far")
            stack.callback(lock.release)
        stack.enter_context(sweeping([root, *(root / one for one in ("charts", "runs", "styles", WORST))]))
        return _results(runner, stress, conditions, before, baselines, force)


def _content_digest(scene: Artifact) -> str:
    """Return the digest of a scene's files, without their origin: a baseline must be valid on other machines."""
    from schemas.canonical_json import digest_of

    return digest_of([(record.path, record.sha256) for record in scene.manifest.files])


def _results(
    runner: StageRunner,
    stress: "Stress",
    conditions: dict[str, Any],
    before: Sequence[dict[str, Any]] | None,
    baselines: Baselines,
    force: bool,
) -> dict[str, Any]:
    """Run the trials and write all results. before: the cells of the baseline."""
    from schemas.atomic_write import write_bytes, write_json
    from stages.evaluation.metrics import write_csv
    from stages.stress.baseline import compared, write_baseline
    from stages.stress.outcomes import cells_of
    from stages.stress.page import build_page, cell_rows, heat_map, run_rows
    from stages.stress.trials import WORST

    root = stress.root
    outcomes = stress.run(runner.only, force)
    if not outcomes:
        if stress.missing:
            raise BadInput(next(iter(stress.missing.values())))
        raise ArtifactStale(f"no results of these trials in {root}; leave out --only to run them")
    cells = cells_of(outcomes)
    comparison = None if before is None else compared(before, cells)
    chart = heat_map(cells)
    write_bytes(root / "charts" / "heat_map.svg", chart.svg.encode())
    write_bytes(root / "charts" / "heat_map.png", chart.png)
    write_csv(root / "cells.csv", cell_rows(cells))
    write_csv(root / "runs.csv", run_rows(outcomes))
    missing = list(stress.missing.items())
    described = {"work": runner.work.root, **conditions}
    page = build_page(cells, chart, described, missing, comparison, root / WORST)
    write_bytes(root / "stress.html", page.encode())
    content = {
        "conditions": conditions,
        "cells": [cell.as_json() for cell in cells],
        "missing": [{"fault": name, "why": why} for name, why in missing],
        "baseline": None if comparison is None else asdict(comparison),
    }
    write_json(root / "stress.json", content)
    if baselines.write:
        write_baseline(baselines.write, cells, conditions)
    result = {"page": root / "stress.html", "heat_map": root / "charts" / "heat_map.svg", **content}
    if comparison is not None and comparison.worse:
        for line in comparison.worse[1:]:
            runner.say(line)
        more = f" ({len(comparison.worse)} cells are worse than in {baselines.read})"
        raise Regression(comparison.worse[0] + more, result)
    if comparison is not None and not comparison.matched:
        raise Regression(f"no cell could be compared with {baselines.read} ({comparison.unmatched[0]})", result)
    return result
