"""`stylerf eval WORK [--of NAME]`: figures, charts and a page about one field."""

from typing import Any

from stages.configs.evaluate import EvaluateConfig
from stylerf_cli.arguments import Parser
from stylerf_cli.session import Session

NAME = "eval"
HELP = "measure quality, style, consistency and cost of a field"
CONFIG = EvaluateConfig


def add_arguments(parser: Parser) -> None:
    """WORK, --of, --path, --region, --base, --robust-to."""
    parser.add_argument("work", metavar="WORK", help="the work folder")
    parser.add_argument("--of", metavar="FIELD", default="", help="field to measure (default: the newest)")
    parser.add_argument(
        "--path",
        metavar="PATH",
        default="",
        help="camera path for consistency, rendered if missing (default: that of the newest video)",
    )
    parser.add_argument(
        "--region", metavar="NAME", action="append", default=[], help="region of a local edit to measure; repeatable"
    )
    parser.add_argument(
        "--base", metavar="FIELD", default="", help="field before a local edit (default: the one it started from)"
    )
    parser.add_argument(
        "--robust-to",
        metavar="FIELD",
        default="",
        help="stylized field whose renders were the references; measures robustness",
    )


def run(args: Any, session: Session) -> dict[str, Any]:
    """Return the report's paths, figures, warnings and what was not measured."""
    from stages.artifacts.report import read_report

    report = session.pipeline.evaluate(
        session.config,
        of=args.of,
        path=args.path,
        regions=args.region,
        base=args.base,
        robust_to=args.robust_to,
        name=session.name,
        force=session.force,
    )
    content = read_report(report)
    page = report.file("report.html")
    result = {
        "report": report.path,
        "page": page,
        "field": content["field"],
        "stylized": content["stylized"],
        "figures": {figure["key"]: figure["mean"] for figure in content["figures"]},
        "protocols": {figure["key"]: figure["protocol"] for figure in content["figures"]},
        "warnings": content["warnings"],
        "not_measured": content["not_measured"],
        "seconds": report.manifest.seconds,
    }
    width = max((len(figure["label"]) for figure in content["figures"]), default=0)
    lines = [f"{content['field']} on {content['scene']}, {content['view_count']} held-out views"]
    lines += [_figure_line(figure, width) for figure in content["figures"]]
    lines += [f"  note: {text}" for text in content["warnings"]]
    lines.append(f"page: {page}")
    return session.emit(result, lines)


def _figure_line(figure: dict[str, Any], width: int) -> str:
    unit = "" if figure["unit"] == "share" else figure["unit"]
    value = f"{figure['mean']:.{figure['digits']}f} {unit}".rstrip()
    beside = "".join(f"; {name}: {number:.{figure['digits']}f}" for name, number in figure["reference"].items())
    return f"  {figure['label']:<{width}}  {value}{beside}"
