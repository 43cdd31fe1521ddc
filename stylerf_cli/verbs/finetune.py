"""`stylerf finetune WORK --edit NAME`: the field learns an edit, as its photos now show it."""

from stages.configs.finetune import FinetuneConfig

NAME = "finetune"
HELP = "teach a field an edit"
CONFIG = FinetuneConfig


def add_arguments(parser) -> None:
    """WORK, --edit, --of."""
    parser.add_argument("work", metavar="WORK", help="the work folder")
    parser.add_argument("--edit", metavar="EDIT", default="", help="the edit (default: the only one)")
    parser.add_argument("--of", metavar="FIELD", help="field to teach (default: the one the region was selected in)")


def run(args, session) -> dict:
    """The edited field's place and figures."""
    from stages.pipeline.local_edit import edit_of, finetuned
    from stages.pipeline.prerequisites import chosen_field

    edit = edit_of(session, args.edit)
    field = chosen_field(session, args.of) if args.of else None
    made = finetuned(session, edit, field, session.config)
    figures = made.manifest.figures
    result = {"field": made.path, "name": made.name, "figures": figures, "seconds": made.manifest.seconds}
    words = f"field {made.name}: {figures['steps']} steps in {figures['train_seconds']:.0f} s"
    return session.emit(result, [words, f"  {made.path}"])
