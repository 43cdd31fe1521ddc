"""`stylerf edit WORK --at VIEW:X,Y --recolor --palette 0=#c03020`: a whole local edit in one command."""

from stages.configs.finetune import FinetuneConfig
from stages.configs.whole_edit import WholeEditConfig

NAME = "edit"
HELP = "select, recolor or stylize a part of the scene, and teach the field: all in one"
CONFIG = WholeEditConfig


def add_arguments(parser) -> None:
    """WORK, --of."""
    parser.add_argument("work", metavar="WORK", help="the work folder")
    parser.add_argument("--of", metavar="FIELD", help="field to edit (default: the fitted one)")


def run(args, session) -> dict:
    """The edited field's place, what came between, and the seconds of each stage."""
    from stages.pipeline.local_edit import edit_dataset_of, ensure_distilled, finetuned, learned_edit
    from stages.pipeline.prerequisites import chosen_field, ensure_field, scene_of_work
    from stages.region_select import masks_of
    from stages.run.runner import refuse_to_replace
    from stylerf_cli.verbs.select import selected
    from stylerf_cli.verbs.stylize import pinned, told_palette

    config = session.config
    name = args.name or "edit"
    session.name = None  # each artifact of the chain has a name of its own
    session.own_verbs = {"select", "extract", "stylize", "distill", "finetune"}
    # Refused before the first stage, not after it.
    look, _ = pinned(config.look, name)
    masks_of(config.selection)
    given = chosen_field(session, args.of) if args.of else None
    start = given or ensure_field(session, scene_of_work(session))
    for kind in ("region", "edit-dataset", "edit", "scene", "field"):
        refuse_to_replace(session.work, kind, name, [start])
    region = selected(session, config.selection, given, name)
    edit = learned_edit(session, region, look.learning, look.changes, name, name)
    scene = ensure_distilled(session, edit)
    field = finetuned(session, edit, given, session.config_of("finetune", FinetuneConfig))
    made = {
        "region": region,
        "edit-dataset": edit_dataset_of(session, edit),
        "edit": edit,
        "scene": scene,
        "field": field,
    }
    seconds = {kind: round(one.manifest.seconds, 1) for kind, one in made.items()}
    result = {kind.replace("-", "_"): one.path for kind, one in made.items()} | {"name": name, "seconds": seconds}
    times = ", ".join(f"{kind} {value:.0f} s" for kind, value in seconds.items())
    return session.emit(result, [*told_palette(edit), f"field {field.name}: {times}", f"  {field.path}"])
