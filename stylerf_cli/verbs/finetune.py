"""`stylerf finetune WORK --edit NAME`: a field trained on photos with an edit painted in."""

from typing import Any

from stages.configs.edit import FinetuneConfig
from stylerf_cli.arguments import Parser
from stylerf_cli.session import Session, made

NAME = "finetune"
CONFIG = FinetuneConfig


def add_arguments(parser: Parser) -> None:
    """WORK, --edit, --of."""
    parser.add_argument("work", metavar="WORK", help="the work folder")
    parser.add_argument("--edit", metavar="EDIT", default="", help="the edit (default: the only one)")
    parser.add_argument(
        "--of", metavar="FIELD", default="", help="field to train (default: the one the region was selected in)"
    )


def run(args: Any, session: Session) -> dict[str, Any]:
    """Return path, name and figures of the edited field."""
    field = session.pipeline.finetune(
        session.config, edit=args.edit, of=args.of, name=session.name, force=session.force
    )
    figures = field.manifest.figures
    words = f"field {field.name}: {figures['steps']} steps in {figures['train_seconds']:.0f} s"
    return session.emit(made("field", field), [words, f"  {field.path}"])
