"""`stylerf fit WORK`: a radiance field from the scene's photos."""

from typing import TYPE_CHECKING, Any

from stages.configs.fit import FitConfig
from stylerf_cli.arguments import Parser
from stylerf_cli.session import Session, made

if TYPE_CHECKING:  # imports numpy, which must not delay `--help`
    from schemas.work_folder import Artifact

CONFIG = FitConfig


def add_arguments(parser: Parser) -> None:
    """WORK."""
    parser.add_argument("work", metavar="WORK", help="the work folder")


def run(args: Any, session: Session) -> dict[str, Any]:
    """Return path, name and figures of the field, and the path of its buffers."""
    field = session.pipeline.fit(session.config, name=session.name, force=session.force)
    figures = field.manifest.figures
    result = made("field", field)
    if session.config.buffers and not session.only:
        result["buffers"] = session.pipeline.render_views(field).path
    return session.emit(result, _words(field, figures))


def _words(field: "Artifact", figures: dict[str, Any]) -> list[str]:
    lines = [
        f"field {field.name}: {_size(figures)}, "
        f"{figures['parameters'] / 1e6:.2f} M parameters, {figures['train_seconds']:.0f} s, {figures['steps']} steps"
    ]
    if figures["held_out_psnr"] is not None:
        kept = figures["held_out_views"]
        lines.append(f"  held-out views: {figures['held_out_psnr']:.2f} dB ({kept} training views held out)")
    elif figures["training_psnr"] is not None:
        lines.append(f"  training views: {figures['training_psnr']:.2f} dB (no view was held out; see --held-out)")
    lines += [f"  {decision}" for decision in figures["decisions"]]
    return [*lines, f"  {field.path}"]


def _size(figures: dict[str, Any]) -> str:
    """Describe the kinds and the size of a field."""
    density, color, head = figures["kinds"]
    words = [f"{density if density == color else f'{density}+{color}'} {figures['resolution']}^3"]
    ranks = [figures[f"{part}_rank"] for part in ("density", "color")]
    if any(ranks):
        words.append(f"rank{'s' if all(ranks) else ''} {' and '.join(str(rank) for rank in ranks if rank)}")
    if figures["table_bits"]:
        words.append(f"tables of 2^{figures['table_bits']}")
    return ", ".join(words if head == "linear" else [*words, "colors by a network"])
