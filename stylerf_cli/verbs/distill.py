"""`stylerf distill WORK --edit NAME`: the training photos with an edit painted in."""

from typing import Any

from stages.configs.edit import DistillConfig
from stylerf_cli.arguments import Parser
from stylerf_cli.session import Session, made

NAME = "distill"
CONFIG = DistillConfig


def add_arguments(parser: Parser) -> None:
    """WORK, --edit."""
    parser.add_argument("work", metavar="WORK", help="the work folder")
    parser.add_argument("--edit", metavar="EDIT", default="", help="the edit (default: the only one)")


def run(args: Any, session: Session) -> dict[str, Any]:
    """Return path, name and figures of the edited scene."""
    scene = session.pipeline.distill(session.config, edit=args.edit, name=session.name, force=session.force)
    figures = scene.manifest.figures
    words = f"scene {scene.name}: {figures['pixels']} pixels edited in {figures['views']} photos"
    return session.emit(made("scene", scene), [words, f"  {scene.path}"])
