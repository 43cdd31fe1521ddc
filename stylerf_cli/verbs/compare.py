"""`stylerf compare WORK...`: what runs cost and how good they are, with Pareto fronts."""

from pathlib import Path
from typing import Any

from schemas.errors import UsageError
from schemas.work_folder import Artifact, WorkFolder
from stylerf_cli.arguments import Parser
from stylerf_cli.path_arguments import work_or_artifact
from stylerf_cli.session import Session

CONFIG = None
NAMELESS = "a comparison is not an artifact"
FOLDER = "comparison"


def add_arguments(parser: Parser) -> None:
    """WORK..., --out."""
    parser.add_argument("works", metavar="WORK", nargs="+", type=Path, help="the work folders")
    parser.add_argument("--out", metavar="DIR", type=Path, help=f"output folder (default: {FOLDER} in the first WORK)")


def run(args: Any, session: Session) -> dict[str, Any]:
    """Return what compare.json holds, with the paths of page and table."""
    from stages.comparison.page import compared

    paths: dict[Path, Path] = {}
    for path in args.works:
        paths.setdefault(path.resolve(), path)
    works = [_work_of(path) for path in paths.values()]
    out = args.out or works[0].root / FOLDER
    result = {"out": out, "page": out / "compare.html", "table": out / "runs.csv", **compared(works, out)}
    return session.emit(result, _words(result))


def _work_of(path: Path) -> WorkFolder:
    found = work_or_artifact(path)
    if isinstance(found, Artifact):
        raise UsageError(f"{path} is an artifact; give the work folder that holds it")
    return found


def _words(result: dict[str, Any]) -> list[str]:
    """One line per run with its main figure, then what is missing."""
    lines = []
    for run in result["runs"]:
        seconds, leading = run["costs"]["seconds"], next(iter(run["metrics"].values()), None)
        metric = f"{leading['label']} {leading['mean']:.4g} {leading['unit']}".rstrip() if leading else "not evaluated"
        mark = "*" if run["fronts"] else " "
        lines.append(f"{mark} {run['family'][:-1]:<13} {run['work']}/{run['name']}: {seconds:.0f} s, {metric}")
    lines.append("* on a Pareto front")
    lines += [f"missing: {gap['what']}. {gap['why']}" for gap in result["missing"]]
    return [*lines, f"page: {result['page']}"]
