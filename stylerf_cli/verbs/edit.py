"""`stylerf edit WORK --at VIEW:X,Y --recolor --palette 0=#c03020`: a whole local edit in one command."""

from typing import Any

from stages.configs.edit import WholeEditConfig
from stylerf_cli.arguments import Parser
from stylerf_cli.output import palette_lines
from stylerf_cli.session import Session

CONFIG = WholeEditConfig


def add_arguments(parser: Parser) -> None:
    """WORK, --of."""
    parser.add_argument("work", metavar="WORK", help="the work folder")
    parser.add_argument("--of", metavar="FIELD", default="", help="field to edit (default: the fitted one)")


def run(args: Any, session: Session) -> dict[str, Any]:
    """Return the path of each artifact, their common name, and the seconds of each stage."""
    name = session.name or "edit"
    edit = session.pipeline.edit(session.config, of=args.of, name=name, force=session.force)
    made = edit.artifacts()
    seconds = {kind: round(one.manifest.seconds, 1) for kind, one in made.items()}
    result = {kind.replace("-", "_"): one.path for kind, one in made.items()} | {"name": name, "seconds": seconds}
    times = ", ".join(f"{kind} {value:.0f} s" for kind, value in seconds.items())
    words = [*palette_lines(edit.edit), f"field {edit.field.name}: {times}", f"  {edit.field.path}"]
    return session.emit(result, words)
