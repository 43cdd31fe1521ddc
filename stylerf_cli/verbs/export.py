"""`stylerf export WORK`: meshes, splats, cameras and shots for other programs."""

from typing import Any

from stages.configs.export import ExportConfig
from stylerf_cli.arguments import Parser
from stylerf_cli.session import Session, made

CONFIG = ExportConfig


def add_arguments(parser: Parser) -> None:
    """WORK, --of."""
    parser.add_argument("work", metavar="WORK", help="the work folder")
    parser.add_argument("--of", metavar="FIELD", default="", help="field to export (default: the newest)")


def run(args: Any, session: Session) -> dict[str, Any]:
    """Return path, name and figures of the export."""
    exported = session.pipeline.export(session.config, of=args.of, name=session.name, force=session.force)
    figures = exported.manifest.figures
    counts = [f"{figures[key]:,} {key}" for key in ("vertices", "faces", "splats", "cameras", "photos") if figures.get(key)]
    words = [f"{exported.manifest.config['kind']}: {', '.join(counts)}"]
    words += [f"  {exported.path / file}" for file in figures["files"]]
    return session.emit(made("export", exported), words)
