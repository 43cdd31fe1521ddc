"""`stylerf demo`: the whole pipeline on a built-in procedural scene."""

from typing import Any

from stages.configs.demo import DemoConfig
from stylerf_cli.arguments import Parser
from stylerf_cli.session import Session

CONFIG = DemoConfig
NAMELESS = "the demo names its own artifacts"


def add_arguments(parser: Parser) -> None:
    """WORK."""
    parser.add_argument(
        "work", metavar="WORK", nargs="?", default="stylerf-demo", help="the work folder (default: stylerf-demo)"
    )


def run(args: Any, session: Session) -> dict[str, Any]:
    """Return the paths of contact sheet, reports and video."""
    demo = session.pipeline.demo(session.config, force=session.force)
    result = {
        "sheet": demo.sheet,
        "report": demo.report.path / "report.html",
        "fit_report": demo.fit_report.path / "report.html",
        "video": demo.video.path / demo.video.manifest.figures["video"],
        "psnr": demo.fit_report.manifest.figures["psnr"],
    }
    words = [
        f"held-out views: {result['psnr']:.2f} dB after {session.config.fit_budget}",
        f"contact sheet: {result['sheet']}",
        f"report:        {result['report']}",
        f"fit report:    {result['fit_report']}",
        f"video:         {result['video']}",
    ]
    return session.emit(result, words)
