"""`stylerf extract WORK --region NAME`: what the views show of a region, for its edit to learn from."""

from stages.configs.extract import ExtractConfig

NAME = "extract"
HELP = "gather what the views show of a region, for its edit"
CONFIG = ExtractConfig


def add_arguments(parser) -> None:
    """WORK, --region, --of."""
    parser.add_argument("work", metavar="WORK", help="the work folder")
    parser.add_argument("--region", metavar="REGION", default="", help="the region (default: the only one)")
    parser.add_argument("--of", metavar="FIELD", help="field to look at (default: the one it was selected in)")


def run(args, session) -> dict:
    """The edit dataset's place and figures."""
    from stages.pipeline.local_edit import ensure_edit_dataset, region_of
    from stages.pipeline.prerequisites import chosen_field

    region = region_of(session, args.region)
    field = chosen_field(session, args.of) if args.of else None
    made = ensure_edit_dataset(session, region, field, session.config)
    figures = made.manifest.figures
    hidden = f", hidden in {len(figures['hidden'])}: {' '.join(figures['hidden'][:8])}" if figures["hidden"] else ""
    result = {"edit_dataset": made.path, "name": made.name, "figures": figures, "seconds": made.manifest.seconds}
    words = f"edit dataset {made.name}: {figures['pixels']} pixels in {figures['views']} views{hidden}"
    return session.emit(result, [words, f"  {made.path}"])
