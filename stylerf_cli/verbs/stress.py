"""`stylerf stress WORK`: methods under faults, over several seeds: success rates, regressions against a baseline."""

from pathlib import Path
from typing import Any

from stages.configs.stress import StressConfig
from stylerf_cli.arguments import Parser
from stylerf_cli.session import Session

CONFIG = StressConfig
NAMELESS = "a stress run writes no artifact in WORK"


def add_arguments(parser: Parser) -> None:
    """WORK, --baseline, --write-baseline."""
    parser.add_argument("work", metavar="WORK", help="a work folder with a scene")
    parser.add_argument(
        "--baseline", metavar="FILE", type=Path, help="compare with this file; exit code 1 if a cell is worse"
    )
    parser.add_argument(
        "--write-baseline",
        metavar="FILE",
        type=Path,
        nargs="?",
        const=True,
        help="write a baseline (default FILE: WORK/stress/baseline.json)",
    )


def run(args: Any, session: Session) -> dict[str, Any]:
    """Return the contents of stress.json, with the paths of page and heat map."""
    from stages.pipeline.stress import BASELINE, FOLDER

    pipeline, write = session.pipeline, args.write_baseline
    result = pipeline.stress(
        session.config,
        baseline=args.baseline,
        write_baseline=pipeline.work.root / FOLDER / BASELINE if write is True else write,
        force=session.force,
    )
    return session.emit(result, _words(result))


def _words(result: dict[str, Any]) -> list[str]:
    """One line per cell, with the reason for failures, then what was left out and the comparison with the baseline."""
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
        comparison = result["baseline"]
        lines += [f"better: {line}" for line in comparison["better"]]
        lines += [f"not compared: {line}" for line in comparison["unmatched"]]
        lines.append(f"no cell of {comparison['matched']} compared is worse than in the baseline")
    return [*lines, f"page: {result['page']}"]
