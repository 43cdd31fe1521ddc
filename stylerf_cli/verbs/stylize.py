"""`stylerf stylize WORK --style IMAGE`: a scene, or with --region a part of it, in the strokes of a style image; with
--method palettenerf, a scene in other colors of its palette."""

from itertools import pairwise
from pathlib import Path
from typing import Any

from schemas.errors import UsageError
from stages.configs.decompose import METHOD, PaletteFieldConfig
from stages.configs.edit import RegionConfig
from stages.configs.stylize import CONFIGS as METHOD_CONFIGS
from stages.configs.stylize import ArfConfig, refuse_foreign
from stylerf_cli.arguments import Parser, read_toml
from stylerf_cli.output import palette_lines
from stylerf_cli.session import Session

NAME = "stylize"
CONFIG = ArfConfig
CONFIGS = (*METHOD_CONFIGS.values(), RegionConfig, PaletteFieldConfig)
WITHIN = "refnpr"  # the only method for whole scenes that also stylizes a region; the default there is LAENeRF


def options_for(argv: list[str]) -> type:
    """Return the config for this use: each method, a region and a palette have their own options."""
    pairs = [(flag, value) for one in argv for flag, equals, value in [one.partition("=")] if equals] + [
        *pairwise(argv)
    ]
    method = next((value for flag, value in pairs if flag == "--method"), "")
    table = _table_of(next((value for flag, value in pairs if flag == "--config"), ""))
    if any(one.partition("=")[0] == "--region" for one in argv):
        # A file may also be for whole scenes, whose other methods do not apply to a region.
        method = method or (WITHIN if table.get("method") == WITHIN else "")
        if method not in ("", WITHIN):
            raise UsageError(
                f"--method {method} stylizes whole scenes; with --region, use --method {WITHIN} (from a stylized view) "
                "or none (LAENeRF)"
            )
        if not method:
            return RegionConfig
    method = method or str(table.get("method", ArfConfig.method))
    if method in METHOD_CONFIGS:
        flags = [one.partition("=")[0].removeprefix("--").removeprefix("no-") for one in argv if one.startswith("--")]
        try:
            refuse_foreign(method, (name.replace("-", "_") for name in (*flags, *table)))
        except ValueError as error:
            raise UsageError(str(error)) from error
    return PaletteFieldConfig if method == METHOD else METHOD_CONFIGS.get(method, ArfConfig)


def _table_of(file: str) -> dict[str, Any]:
    """Return the options for this verb in a --config file; none if the file is missing, which is reported later."""
    content = read_toml(Path(file)) if Path(file).is_file() else {}
    own = content.get(NAME, {})
    top = {key: value for key, value in content.items() if not isinstance(value, dict)}
    return {**top, **own} if isinstance(own, dict) else top


def add_arguments(parser: Parser) -> None:
    """WORK, --of, --region."""
    parser.add_argument("work", metavar="WORK", help="the work folder")
    parser.add_argument("--of", metavar="FIELD", default="", help="field to stylize (default: the fitted one)")
    parser.add_argument(
        "--region",
        metavar="REGION",
        help="recolor or stylize only this region; see `stylerf stylize --region NAME --help`",
    )


def run(args: Any, session: Session) -> dict[str, Any]:
    """Return path, name and figures of the stylized field, or of a region's edit."""
    pipeline, config = session.pipeline, session.config
    common = {"of": args.of, "name": session.name, "force": session.force}
    if isinstance(config, RegionConfig):
        made, kind = pipeline.stylize_region(config, region=args.region, **common), "edit"
        words = palette_lines(made)
    elif isinstance(config, PaletteFieldConfig):
        made, kind = pipeline.decompose(config, **common), "field"
        words = palette_lines(made, "field")
    else:
        made, kind = pipeline.stylize(config, region=args.region, **common), "field"
        figures = made.manifest.figures
        words = [
            f"field {made.name}: {figures['steps']} style steps over {figures['views']} views in "
            f"{figures['train_seconds']:.0f} s, features {figures['features']['name']}",
            f"  {made.path}",
        ]
    manifest = made.manifest
    result = {kind: made.path, "name": made.name, "figures": manifest.figures, "seconds": manifest.seconds}
    return session.emit(result, words)
