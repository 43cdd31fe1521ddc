"""`stylerf blend WORK --of A=0.4 B=0.6`: a field that mixes stylizations of one field, by weight or by region."""

from typing import Any

from stages.configs.blend import BlendConfig
from stylerf_cli.arguments import Parser
from stylerf_cli.session import Session, made

NAME = "blend"
CONFIG = BlendConfig


def add_arguments(parser: Parser) -> None:
    """WORK."""
    parser.add_argument("work", metavar="WORK", help="the work folder")


def run(args: Any, session: Session) -> dict[str, Any]:
    """Return path, name and figures of the blended field."""
    field = session.pipeline.blend(session.config, name=session.name, force=session.force)
    figures = field.manifest.figures
    where = {part: f" in {part.region}" if part.region else "" for part in session.config.parts}
    shares = [f"{part.field}{place} {part.weight:g}" for part, place in where.items()]
    if figures["source_weight"]:
        shares.append(f"{figures['source']} {figures['source_weight']:g}")
    words = [f"field {field.name}: {', '.join(shares)}", f"  {field.path}"]
    return session.emit(made("field", field), words)
