"""`stylerf compare WORK...`: what runs cost and how good they are, in charts with Pareto fronts, from what stands."""

import shlex
from dataclasses import asdict
from pathlib import Path

from schemas.errors import ArtifactStale, UsageError
from schemas.work_folder import Artifact, WorkFolder
from stylerf_cli.path_arguments import work_or_artifact

NAME = "compare"
HELP = "set fits, stylizations and edits side by side: figures against time, memory, parameters"
CONFIG = None
NAMELESS = "a comparison is no artifact"
FOLDER = "comparison"


def add_arguments(parser) -> None:
    """WORK..., --out."""
    parser.add_argument("works", metavar="WORK", nargs="+", type=Path, help="work folders; what stands there is read")
    parser.add_argument(
        "--out", metavar="DIR", type=Path, help=f"folder for page, table, charts (default: {FOLDER} in the first WORK)"
    )


def run(args, session) -> dict:
    """Writes compare.json, runs.csv, compare.html, charts/; returns what compare.json holds, with their places.

    A verb without a stage: it reads any number of work folders, and an artifact is made from artifacts of one.
    """
    from schemas.atomic_write import write_bytes, write_json
    from stages.comparison.cost_charts import comparison_charts
    from stages.comparison.page import FAMILIES, build_page, rows_of
    from stages.comparison.pareto_fronts import disagreements, on_fronts
    from stages.comparison.runs import CHARTED, runs_of, thread_mismatches
    from stages.evaluation.metrics import write_csv

    paths: dict[Path, Path] = {}
    for path in args.works:
        paths.setdefault(path.resolve(), path)
    works = [work_of(path) for path in paths.values()]
    runs, gaps = runs_of(works)
    if not runs:
        maker = shlex.join(["stylerf", "fit", str(works[0].root)])
        raise ArtifactStale(f"no field to compare in {works[0].root}; make one with: {maker}")
    fronts: dict[str, list[str]] = {}
    for family in FAMILIES:
        some = [one for one in runs if one.family == family]
        gaps += thread_mismatches(some)
        gaps += disagreements(some, list(CHARTED[family]))
        fronts |= on_fronts(some, list(CHARTED[family]))
    charts = comparison_charts(runs)
    out = args.out or works[0].root / FOLDER
    for chart in charts:
        write_bytes(out / "charts" / f"{chart.name}.svg", chart.svg.encode())
        write_bytes(out / "charts" / f"{chart.name}.png", chart.png)
    rows = rows_of(runs, fronts)
    write_csv(out / "runs.csv", rows)
    write_bytes(out / "compare.html", build_page(runs, charts, gaps, fronts).encode())
    told = {
        "works": [work.root for work in works],
        "runs": [asdict(one) | {"fronts": fronts[one.title]} for one in runs],
        "missing": [asdict(gap) for gap in gaps],
        "charts": [f"charts/{chart.name}.svg" for chart in charts],
    }
    write_json(out / "compare.json", told)
    result = {"out": out, "page": out / "compare.html", "table": out / "runs.csv", **told}
    return session.emit(result, words_of(result))


def work_of(path: Path) -> WorkFolder:
    """The work folder there; UsageError for the folder of one artifact."""
    found = work_or_artifact(path)
    if isinstance(found, Artifact):
        raise UsageError(f"{path} is one artifact; give the work folder that it stands in")
    return found


def words_of(result: dict) -> list[str]:
    """One line a run with its leading figure, then what is missing."""
    lines = []
    for run in result["runs"]:
        seconds, leading = run["costs"]["seconds"], next(iter(run["metrics"].values()), None)
        metric = f"{leading['label']} {leading['mean']:.4g} {leading['unit']}".rstrip() if leading else "not evaluated"
        mark = "*" if run["fronts"] else " "
        lines.append(f"{mark} {run['family'][:-1]:<13} {run['work']}/{run['name']}: {seconds:.0f} s, {metric}")
    lines.append("* on a Pareto front")
    lines += [f"missing: {gap['what']}. {gap['why']}" for gap in result["missing"]]
    return [*lines, f"page: {result['page']}"]
