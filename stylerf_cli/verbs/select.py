"""`stylerf select WORK --at VIEW:X,Y`: a part of the scene in 3D, to be edited or masked out."""

from dataclasses import replace

from stages.configs.select import SelectConfig

NAME = "select"
HELP = "select a part of the scene in 3D, by pixels, masks, a box or a color"
CONFIG = SelectConfig


def add_arguments(parser) -> None:
    """WORK, --of."""
    parser.add_argument("work", metavar="WORK", help="the work folder")
    parser.add_argument("--of", metavar="FIELD", help="field to select in (default: the fitted one)")


def run(args, session) -> dict:
    """The region's place, figures and previews."""
    from stages.pipeline.prerequisites import chosen_field

    made = selected(session, session.config, chosen_field(session, args.of) if args.of else None)
    figures = made.manifest.figures
    previews = [str(made.path / "preview" / f"{name}.png") for name in figures["previews"]]
    result = {"region": made.path, "name": made.name, "figures": figures, "previews": previews}
    words = (
        f"region {made.name}: {figures['edit_cells']} cells of a {figures['cells']}^3 grid, "
        f"{figures['solid_share']:.1%} of what is solid"
    )
    return session.emit(result, [words, *(f"  {preview}" for preview in previews)])


def selected(session, config: SelectConfig, field, name: str = "region"):
    """The region artifact. field: the one to select in, None for the fitted one."""
    from stages import region_select
    from stages.pipeline.prerequisites import ensure_field, pictures_of, scene_of_work

    config = replace(config, files_digest=region_select.digest_of_masks(config))
    if field:
        scene = pictures_of(session, field)
    else:
        scene = scene_of_work(session)
        field = ensure_field(session, scene)
    inputs = {"scene": scene, "field": field}
    for kind in ("union", "subtract", "intersect"):
        for other in getattr(config, kind):
            inputs[f"{kind}.{other}"] = session.work.find("region", other)
    return session.run(region_select.SPEC, region_select.run, inputs, config, name)
