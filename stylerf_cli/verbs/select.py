"""`stylerf select WORK --at VIEW:X,Y`: a region of the scene in 3D, to edit or to render masks of."""

from typing import Any

from stages.configs.select import SelectConfig
from stylerf_cli.arguments import Parser
from stylerf_cli.session import Session

CONFIG = SelectConfig


def add_arguments(parser: Parser) -> None:
    """WORK, --of."""
    parser.add_argument("work", metavar="WORK", help="the work folder")
    parser.add_argument("--of", metavar="FIELD", default="", help="field to select in (default: the fitted one)")


def run(args: Any, session: Session) -> dict[str, Any]:
    """Return path, name, figures and previews of the region."""
    made = session.pipeline.select(session.config, of=args.of, name=session.name, force=session.force)
    figures = made.manifest.figures
    previews = [str(made.path / "preview" / f"{name}.png") for name in figures["previews"]]
    result = {"region": made.path, "name": made.name, "figures": figures, "previews": previews}
    words = (
        f"region {made.name}: {figures['edit_cells']} cells of a {figures['cells']}^3 grid, "
        f"{figures['solid_share']:.1%} of what is solid"
    )
    return session.emit(result, [words, *(f"  {preview}" for preview in previews)])
