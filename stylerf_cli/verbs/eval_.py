"""`stylerf eval WORK [--of NAME]`: figures, charts and a page about one field."""

from typing import Any

from stages.configs.evaluate import EvaluateConfig
from stylerf_cli.arguments import Parser
from stylerf_cli.session import Session

NAME = "eval"
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
        "figures": {metric["key"]: metric["mean"] for metric in content["metrics"]},
        "protocols": {metric["key"]: metric["protocol"] for metric in content["metrics"]},
        "warnings": content["warnings"],
        "not_measured": content["not_measured"],
        "seconds": report.manifest.seconds,
    }
    width = max((len(metric["label"]) for metric in content["metrics"]), default=0)
    lines = [f"{content['field']} on {content['scene']}, {content['view_count']} held-out views"]
    lines += [_metric_line(metric, width) for metric in content["metrics"]]
    lines += [f"  note: {text}" for text in content["warnings"]]
    lines.append(f"page: {page}")
    return session.emit(result, lines)


def _metric_line(metric: dict[str, Any], width: int) -> str:
    unit = "" if metric["unit"] == "fraction" else metric["unit"]
    value = f"{metric['mean']:.{metric['digits']}f} {unit}".rstrip()
    references = "".join(f"; {name}: {mean:.{metric['digits']}f}" for name, mean in metric["reference"].items())
    return f"  {metric['label']:<{width}}  {value}{references}"
