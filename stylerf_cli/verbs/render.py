"""`stylerf render WORK`: views of a field as EXR, PNG and video."""

from typing import Any

from stages.configs.render import RenderConfig
from stylerf_cli.arguments import Parser
from stylerf_cli.session import Session, made

CONFIG = RenderConfig


def add_arguments(parser: Parser) -> None:
    """WORK, --of."""
    parser.add_argument("work", metavar="WORK", help="the work folder")
    parser.add_argument("--of", metavar="FIELD", default="", help="field to render (default: the newest)")


def run(args: Any, session: Session) -> dict[str, Any]:
    """Return path, name and figures of the frames, and the regions they have masks of."""
    from stylerf.geometry.camera_paths import PATHS

    if session.config.count != RenderConfig.count and session.config.path not in PATHS:
        session.say(f"--count has no effect: --path {session.config.path} has its own number of frames")
    frames = session.pipeline.render(session.config, of=args.of, name=session.name, force=session.force)
    figures, inputs = frames.manifest.figures, frames.manifest.inputs
    result = made("frames", frames)
    rate = figures["pixels"] / max(frames.manifest.seconds, 1e-9)
    speed = f", {rate / 1e3:.0f} thousand rays per second" if rate else ""
    field = next(ref.name for ref in inputs if ref.role == "field")
    strength = "" if session.config.strength == 1 else f" at strength {session.config.strength:g}"
    words = [f"{figures['frames']} frames of {field}{strength}{speed}", f"  {frames.path}"]
    if figures["video"]:
        words.insert(1, f"  video: {frames.path / figures['video']}")
    if regions := [ref.name for ref in inputs if ref.kind == "region"]:
        result["regions"] = regions
        words.append(f"  masks of {', '.join(regions)}")
    return session.emit(result, words)
