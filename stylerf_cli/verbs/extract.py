"""`stylerf extract WORK --region NAME`: what the views show of a region, for its edit to learn from."""

from typing import Any

from stages.configs.edit import ExtractConfig
from stylerf_cli.arguments import Parser
from stylerf_cli.session import Session, made

NAME = "extract"
CONFIG = ExtractConfig


def add_arguments(parser: Parser) -> None:
    """WORK, --region, --of."""
    parser.add_argument("work", metavar="WORK", help="the work folder")
    parser.add_argument("--region", metavar="REGION", default="", help="the region (default: the only one)")
    parser.add_argument(
        "--of", metavar="FIELD", default="", help="field to render (default: the one the region was selected in)"
    )


def run(args: Any, session: Session) -> dict[str, Any]:
    """Return path, name and figures of the edit dataset."""
    edit_dataset = session.pipeline.extract(
        session.config, region=args.region, of=args.of, name=session.name, force=session.force
    )
    figures = edit_dataset.manifest.figures
    hidden = f", hidden in {len(figures['hidden'])}: {' '.join(figures['hidden'][:8])}" if figures["hidden"] else ""
    words = f"edit dataset {edit_dataset.name}: {figures['pixels']} pixels in {figures['views']} views{hidden}"
    return session.emit(made("edit_dataset", edit_dataset), [words, f"  {edit_dataset.path}"])
