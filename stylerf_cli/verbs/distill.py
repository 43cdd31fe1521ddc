"""`stylerf distill WORK --edit NAME`: the training photos with an edit painted into them."""

from stages.configs.distill import DistillConfig

NAME = "distill"
HELP = "paint an edit into the training photos"
CONFIG = DistillConfig


def add_arguments(parser) -> None:
    """WORK, --edit."""
    parser.add_argument("work", metavar="WORK", help="the work folder")
    parser.add_argument("--edit", metavar="EDIT", default="", help="the edit (default: the only one)")


def run(args, session) -> dict:
    """The edited scene's place and figures."""
    from stages.pipeline.local_edit import edit_of, ensure_distilled

    made = ensure_distilled(session, edit_of(session, args.edit), session.config)
    figures = made.manifest.figures
    result = {"scene": made.path, "name": made.name, "figures": figures, "seconds": made.manifest.seconds}
    words = f"scene {made.name}: {figures['pixels']} pixels edited in {figures['views']} photos"
    return session.emit(result, [words, f"  {made.path}"])
