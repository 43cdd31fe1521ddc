"""`stylerf stylize WORK --style IMAGE`: the scene in a painting's colours and strokes."""

import re
from dataclasses import replace
from pathlib import Path

from stages.configs.stylize import StylizeConfig

NAME = "stylize"
HELP = "stylise the whole scene with a painting"
CONFIG = StylizeConfig


def add_arguments(parser) -> None:
    """WORK, --of."""
    parser.add_argument("work", metavar="WORK", help="the work folder")
    parser.add_argument("--of", metavar="FIELD", help="field to stylise (default: the fitted one)")


def run(args, session) -> dict:
    """The stylised field's place and figures."""
    from schemas.canonical import file_sha256
    from schemas.errors import BadInput
    from stages import stylize
    from stylerf_cli.chains import ensure_deformed, ensure_field, scene_of_work

    style = Path(session.config.style)
    if not style.is_file():
        raise BadInput(f"--style {style}: there is no such image")
    # Refused before hours of upstream work, not after them.
    stylize.read_painting(style)
    scene = scene_of_work(session)
    field = session.work.find("field", args.of) if args.of else ensure_field(session, scene)
    if session.config.method == "desrf":
        field = ensure_deformed(session, scene, field)
    config = replace(session.config, style=str(style.resolve()), style_digest=file_sha256(style))
    made = session.run(
        stylize.SPEC, stylize.run, {"scene": scene, "field": field}, config, f"{_name_of(style)}-{config.method}"
    )
    figures = made.manifest.figures
    result = {"field": made.path, "name": made.name, "figures": figures, "seconds": made.manifest.seconds}
    words = (
        f"field {made.name}: {figures['steps']} style steps over {figures['views']} views in "
        f"{figures['train_seconds']:.0f} s, features {figures['features']['name']}\n  {made.path}"
    )
    return session.emit(result, words)


def _name_of(style: Path) -> str:
    """The painting's file name as an artefact's name may be written."""
    return re.sub(r"[^A-Za-z0-9._+-]+", "_", style.stem).strip("._+-") or "style"
