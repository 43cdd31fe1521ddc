"""`stylerf fit WORK`: a radiance field from the scene's photos."""

from contextlib import suppress

from schemas.errors import ArtifactDamaged, ArtifactStale
from stages.configs.fit import FitConfig

NAME = "fit"
HELP = "fit a radiance field to a scene, no larger than it needs"
CONFIG = FitConfig
# Of a rendered pixel on disk, EXR and PNG, as measured: a capture fills its pictures, an object a part of them.
CAPTURE_BYTES, OBJECT_BYTES = 14, 6


def add_arguments(parser) -> None:
    """WORK."""
    parser.add_argument("work", metavar="WORK", help="the work folder")


def run(args, session) -> dict:
    """The field's place and figures."""
    from stages import nerf_fit
    from stages.pipeline.prerequisites import FIT_NAME, ensure_frames, scene_of_work

    scene = scene_of_work(session)
    field = session.run(nerf_fit.SPEC, nerf_fit.run, {"scene": scene}, session.config, FIT_NAME)
    figures = field.manifest.figures
    result = {"field": field.path, "name": field.name, "figures": figures, "seconds": field.manifest.seconds}
    if session.config.buffers and not session.only:
        name = f"{field.name}-views"
        tell_buffers(session, scene, field, name)
        result["buffers"] = ensure_frames(session, field, "views", name).path
    return session.emit(result, _words(field, figures))


def tell_buffers(session, scene, field, name: str) -> None:
    """Says how much is about to be rendered, where it does not stand."""
    from schemas.scene import read_scene
    from stages.run.memory import in_words

    with suppress(ArtifactDamaged, ArtifactStale):  # what is not there, or cannot be read, is rendered
        if field.digest in [ref.digest for ref in session.work.get("frames", name).manifest.inputs]:
            return
    found = read_scene(scene.path)
    views = found.views
    largest = max(views, key=lambda view: view.width * view.height)
    each = OBJECT_BYTES if found.layout == "object" else CAPTURE_BYTES
    size = sum(view.width * view.height for view in views) * each
    session.say(
        f"rendering {len(views)} views of {largest.width}x{largest.height} to EXR and PNG, about {in_words(size)}; "
        "--no-buffers leaves it out"
    )


def _words(field, figures: dict) -> list[str]:
    lines = [
        f"field {field.name}: {_size(figures)}, "
        f"{figures['parameters'] / 1e6:.2f} M parameters, {figures['train_seconds']:.0f} s, {figures['steps']} steps"
    ]
    if figures["held_out_psnr"] is not None:
        kept = figures["held_out_views"]
        lines.append(f"  held-out views: {figures['held_out_psnr']:.2f} dB ({kept} training views kept aside)")
    elif figures["training_psnr"] is not None:
        lines.append(f"  training views: {figures['training_psnr']:.2f} dB (no view was held out; see --held-out)")
    lines += [f"  {decision}" for decision in figures["decisions"]]
    return [*lines, f"  {field.path}"]


def _size(figures: dict) -> str:
    """In words: what the field is made of, and how much of it."""
    density, color, head = figures["kinds"]
    words = [f"{density if density == color else f'{density}+{color}'} {figures['resolution']}^3"]
    ranks = [figures[f"{part}_rank"] for part in ("density", "color")]
    if any(ranks):
        words.append(f"rank{'s' if all(ranks) else ''} {' and '.join(str(rank) for rank in ranks if rank)}")
    if figures["table_bits"]:
        words.append(f"tables of 2^{figures['table_bits']}")
    return ", ".join(words if head == "linear" else [*words, "colors by a network"])
