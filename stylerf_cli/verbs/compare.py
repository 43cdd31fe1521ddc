"""`stylerf compare WORK...`: cost and quality of runs, with Pareto fronts; people's votes."""

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
MOST_PAIRS, LARGEST_PAGE = 60, 1000  # ten minutes of a person's time; a page of a few hundred MB


def add_arguments(parser: Parser) -> None:
    """WORK..., --table, --out, --pairs, --of, --max-pairs, --votes."""
    parser.add_argument("works", metavar="WORK", nargs="*", type=Path, help="the work folders")
    parser.add_argument(
        "--table",
        metavar="FILE",
        type=Path,
        help="compare the runs of a `stylerf farm` table, by its axes, instead of WORK",
    )
    parser.add_argument("--out", metavar="DIR", type=Path, help=f"output folder (default: {FOLDER} in the first WORK)")
    parser.add_argument(
        "--pairs",
        action="store_true",
        help="write pairs.html instead, a blind test: people choose between unnamed stylizations",
    )
    parser.add_argument(
        "--of",
        metavar="FIELD",
        action="append",
        default=[],
        help="with --pairs, a stylized field to show; repeatable (default: all)",
    )
    parser.add_argument(
        "--max-pairs", metavar="N", type=int, help=f"with --pairs, the largest number of pairs (default: {MOST_PAIRS})"
    )
    parser.add_argument(
        "--votes",
        metavar="FILE",
        nargs="+",
        type=Path,
        default=[],
        help="count the votes saved from such pages instead",
    )


def run(args: Any, session: Session) -> dict[str, Any]:
    """Return the contents of compare.json, a page's key or votes.json, with the paths of the written files."""
    if args.pairs and args.votes:
        raise UsageError("--pairs writes a page to vote on, --votes counts votes; give one of them")
    if not args.pairs and (args.of or args.max_pairs is not None):
        raise UsageError("--of and --max-pairs choose what --pairs shows; add --pairs")
    if args.max_pairs is not None and not 1 <= args.max_pairs <= LARGEST_PAGE:
        raise UsageError(f"--max-pairs {args.max_pairs}: expected 1 to {LARGEST_PAGE} pairs")
    if args.table is not None:
        return _table(args, session)
    if not args.works:
        raise UsageError("no work folder given; name at least one, or a table with --table")
    paths: dict[Path, Path] = {}
    for path in args.works:
        paths.setdefault(path.resolve(), path)
    works = [_work_of(path) for path in paths.values()]
    out = args.out or works[0].root / FOLDER
    if args.pairs:
        return _pairs(args, works, out, session)
    if args.votes:
        return _votes(args.votes, works, out, session)
    from stages.comparison.page import compared

    result = {"out": out, "page": out / "compare.html", "table": out / "runs.csv", **compared(works, out)}
    return session.emit(result, _words(result))


def _table(args: Any, session: Session) -> dict[str, Any]:
    if args.works or args.pairs or args.votes or args.out is not None:
        raise UsageError(
            "--table names the work folders and writes to the table's own folder; leave out WORK, --out, --pairs and "
            "--votes"
        )
    from stages.farm.report import written_report
    from stages.farm.table import read_table
    from stylerf_cli.verbs.farm import build

    result = written_report(read_table(args.table, build))
    lines = [f"{one['method']}: mean rank {one['rank']:.2f} in {one['column']} over {one['blocks']} blocks"
             for one in (*result["standings"], *result["edits"]["standings"])]  # fmt: skip
    lines += [f"missing: {gap['what']}. {gap['why']}" for gap in result["missing"]]
    return session.emit(result, [*lines, f"page: {result['page']}"])


def _pairs(args: Any, works: list[WorkFolder], out: Path, session: Session) -> dict[str, Any]:
    from stages.comparison.pairs import KEYS, PAGE, written_pairs

    seed, most = session.common.seed, args.max_pairs or MOST_PAIRS
    key = written_pairs(works, out, args.of, most, seed)
    result = {
        "page": out / PAGE,
        "key": out / KEYS / f"{key['page']}.json",
        "pairs": len(key["pairs"]),
        "contenders": key["contenders"],
        "missing": key["missing"],
    }
    lines = [f"{result['pairs']} pairs of {len(key['contenders'])} stylizations:"]
    lines += [f"  {one['group']}: {one['label']}, field {one['title']}" for one in key["contenders"]]
    lines += [f"missing: {gap['what']}. {gap['why']}" for gap in result["missing"]]
    return session.emit(result, [*lines, f"key: {result['key']}", f"page: {result['page']}"])


def _votes(files: list[Path], works: list[WorkFolder], out: Path, session: Session) -> dict[str, Any]:
    from stages.comparison.votes import counted_votes

    content = counted_votes(works, files, out)
    lines = [f"{content['votes']} votes"]
    for group, rows in content["standings"].items():
        lines.append(f"{group}:")
        lines += [f"  {row['contender']}: won {_share(row)}, {row['same']} the same" for row in rows]
    if content["matchups"]:
        lines.append("head to head:")
    lines += [f"  {one['contender']} against {one['against']}: won {_share(one)}, {one['same']} the same"
              for one in content["matchups"]]  # fmt: skip
    if content["agreement"]:
        lines.append("votes for the run with the better figure:")
    lines += [f"  {one['metric']}: {_share(one)}" for one in content["agreement"]]
    lines += [f"missing: {gap['what']}. {gap['why']}" for gap in content["missing"]]
    result = {"page": out / "votes.html", "table": out / "votes.json", **content}
    return session.emit(result, [*lines, f"page: {result['page']}"])


def _share(row: dict[str, Any]) -> str:
    """Votes won of those decided, with the interval."""
    counts = f"{row['won']} of {row['decided']}"
    if not row["decided"]:
        return counts
    return f"{counts}, {row['share']:.0%} ({row['low']:.0%} to {row['high']:.0%})"


def _work_of(path: Path) -> WorkFolder:
    found = work_or_artifact(path)
    if isinstance(found, Artifact):
        raise UsageError(f"{path} is an artifact; give the work folder that holds it")
    return found


def _words(result: dict[str, Any]) -> list[str]:
    """One line per run with its main figure, then what is missing."""
    from stages.comparison.runs import CHARTED

    lines = []
    for run in result["runs"]:
        metrics, seconds = run["metrics"], run["costs"]["seconds"]
        leading = next((metrics[key] for key in (*CHARTED[run["family"]], *metrics) if key in metrics), None)
        metric = f"{leading['label']} {leading['mean']:.4g} {leading['unit']}".rstrip() if leading else "not evaluated"
        mark = "*" if run["fronts"] else " "
        lines.append(f"{mark} {run['family'][:-1]:<13} {run['work']}/{run['name']}: {seconds:.0f} s, {metric}")
    lines.append("* on a Pareto front")
    lines += [f"missing: {gap['what']}. {gap['why']}" for gap in result["missing"]]
    return [*lines, f"page: {result['page']}"]
