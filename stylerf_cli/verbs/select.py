"""`stylerf select WORK --at VIEW:X,Y`: a part of the scene in 3D, to be edited or masked out."""

from dataclasses import replace
from pathlib import Path

from stages.configs.select import SelectConfig
from stages.configs.views import file_of

NAME = "select"
HELP = "select a part of the scene in 3D, by pixels, masks, a box or a colour"
CONFIG = SelectConfig


def add_arguments(parser) -> None:
    """WORK, --of."""
    parser.add_argument("work", metavar="WORK", help="the work folder")
    parser.add_argument("--of", metavar="FIELD", help="field to select in (default: the fitted one)")


def run(args, session) -> dict:
    """The region's place, figures and previews."""
    from stylerf_cli.chains import chosen_field

    made = selected(session, session.config, chosen_field(session, args.of) if args.of else None)
    figures = made.manifest.figures
    previews = [str(made.path / "preview" / f"{name}.png") for name in figures["previews"]]
    result = {"region": made.path, "name": made.name, "figures": figures, "previews": previews}
    words = (
        f"region {made.name}: {figures['edit_cells']} cells of a {figures['cells']}^3 grid, "
        f"{figures['solid_share']:.1%} of what is solid\n  " + "\n  ".join(previews)
    )
    return session.emit(result, words)


def selected(session, config: SelectConfig, field, name: str = "region"):
    """The region artefact. field: the one to select in, None for the fitted one."""
    from schemas.canonical import digest_of, file_sha256
    from stages import region_select
    from stylerf_cli.chains import ensure_field, pictures_of, scene_of_work

    files = masks_of(config)
    if field:
        scene = pictures_of(session, field)
    else:
        scene = scene_of_work(session)
        field = ensure_field(session, scene)
    inputs = {"scene": scene, "field": field}
    for kind in ("union", "subtract", "intersect"):
        for other in getattr(config, kind):
            inputs[f"{kind}.{other}"] = session.work.find("region", other)
    config = replace(
        config, files_digest=digest_of([[*one, file_sha256(path)] for *one, path in files]) if files else ""
    )
    return session.run(region_select.SPEC, region_select.run, inputs, config, name)


def masks_of(config: SelectConfig) -> list[tuple[str, str, Path]]:
    """Option, view and file of its scribbles and masks; BadInput where one is not there."""
    from schemas.errors import BadInput

    files = [(option, *file_of(text)) for option in ("scribble", "mask") for text in getattr(config, option)]
    if missing := [path for *_, path in files if not path.is_file()]:
        raise BadInput(f"{missing[0]}: there is no such mask")
    return files
