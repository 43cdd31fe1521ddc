"""`stylerf deform WORK`: the fitted field with a deformation, ready to be bent by a painting."""

from stages.configs.deform import DeformConfig

NAME = "deform"
HELP = "give a fitted field a deformation, the start of a stylization that bends shapes"
CONFIG = DeformConfig


def add_arguments(parser) -> None:
    """WORK, --of."""
    parser.add_argument("work", metavar="WORK", help="the work folder")
    parser.add_argument("--of", metavar="FIELD", help="field to deform (default: the fitted one)")


def run(args, session) -> dict:
    """The deformed field's place and figures."""
    from stages.pipeline.prerequisites import deform, ensure_field, scene_of_work, teaching_pictures

    field = ensure_field(session, scene_of_work(session), args.of)
    made = deform(session, teaching_pictures(session, field), field, session.config)
    figures = made.manifest.figures
    result = {"field": made.path, "name": made.name, "figures": figures, "seconds": made.manifest.seconds}
    words = (
        f"field {made.name}: {figures['steps']} steps in {figures['train_seconds']:.0f} s, photos "
        f"{figures['psnr_before']:.2f} -> {figures['psnr_after']:.2f} dB"
    )
    return session.emit(result, [words, f"  {made.path}"])
