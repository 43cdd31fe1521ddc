"""`stylerf render WORK`: views of a field as EXR, PNG and video."""

from stages.configs.render import RenderConfig, label_of

NAME = "render"
HELP = "render a field along a path: EXR with depth for compositors, PNG, video"
CONFIG = RenderConfig


def add_arguments(parser) -> None:
    """WORK, --of."""
    parser.add_argument("work", metavar="WORK", help="the work folder")
    parser.add_argument("--of", metavar="FIELD", help="field to render (default: the one made last)")


def run(args, session) -> dict:
    """The frames' place."""
    from stages import render
    from stages.pipeline.prerequisites import chosen_field, regions_shown, scene_of

    field = chosen_field(session, args.of)
    config = render.pinned(session.config)
    name = f"{field.name}-{label_of(config.path)}" + (f"-{config.frames}" if config.frames else "")
    inputs = {"scene": scene_of(session.work, field), "field": field, **regions_shown(session, field, config)}
    frames = session.run(render.SPEC, render.run, inputs, config, name)
    figures = frames.manifest.figures
    rate = figures["pixels"] / max(frames.manifest.seconds, 1e-9)
    result = {"frames": frames.path, "name": frames.name, "figures": figures, "seconds": frames.manifest.seconds}
    speed = f", {rate / 1e3:.0f} thousand rays a second" if rate else ""
    words = [f"{figures['frames']} frames of {field.name}{speed}", f"  {frames.path}"]
    if figures["video"]:
        words.insert(1, f"  video: {frames.path / figures['video']}")
    if shown := [ref.name for ref in frames.manifest.inputs if ref.kind == "region"]:
        result["regions"] = shown
        words.append(f"  masks of {', '.join(shown)}")
    return session.emit(result, words)
