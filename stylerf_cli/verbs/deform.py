"""`stylerf deform WORK`: a fitted field with a deformation, ready to be bent by a style image."""

from typing import Any

from stages.configs.deform import DeformConfig
from stylerf_cli.arguments import Parser
from stylerf_cli.session import Session, made

CONFIG = DeformConfig


def add_arguments(parser: Parser) -> None:
    """WORK, --of."""
    parser.add_argument("work", metavar="WORK", help="the work folder")
    parser.add_argument("--of", metavar="FIELD", default="", help="field to deform (default: the fitted one)")


def run(args: Any, session: Session) -> dict[str, Any]:
    """Return path, name and figures of the deformed field."""
    field = session.pipeline.deform(session.config, of=args.of, name=session.name, force=session.force)
    figures = field.manifest.figures
    words = (
        f"field {field.name}: {figures['steps']} steps in {figures['train_seconds']:.0f} s, photos "
        f"{figures['psnr_before']:.2f} -> {figures['psnr_after']:.2f} dB"
    )
    return session.emit(made("field", field), [words, f"  {field.path}"])
