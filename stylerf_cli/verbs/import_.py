"""`stylerf import SOURCE WORK`: photos, with poses or without, video or splats into a scene."""

from pathlib import Path
from typing import Any

from stages.configs.pose_import import ImportOptions
from stylerf_cli.arguments import Parser
from stylerf_cli.session import Session

CONFIG = ImportOptions


def add_arguments(parser: Parser) -> None:
    """SOURCE and WORK."""
    parser.add_argument(
        "source",
        type=Path,
        metavar="SOURCE",
        help="folder of photos, alone or with poses of COLMAP, transforms.json, LLFF, Metashape, OpenSfM, Polycam, "
        "Record3D; a clip of video or a folder of clips; splats (.ply, or 3DGS's output folder)",
    )
    parser.add_argument("work", type=Path, metavar="WORK", help="work folder of one scene, created if missing")


def run(args: Any, session: Session) -> dict[str, Any]:
    """Return {"scene": name, "path", "digest", "seconds", ...figures of the import}."""
    artifact = session.pipeline.import_photos(args.source, session.config, name=session.name, force=session.force)
    figures = artifact.manifest.figures
    result = {
        "scene": artifact.name, "path": artifact.path, "digest": artifact.digest,
        "seconds": artifact.manifest.seconds, **figures,
    }  # fmt: skip
    return session.emit(result, _words(result))


def _words(result: dict[str, Any]) -> list[str]:
    low, high = ([f"{value:.3g}" for value in corner] for corner in result["aabb"])
    lines = [
        f"scene {result['scene']} ({result['path']}) from {result['format']}",
        f"  views       {result['views']}: {result['train']} to train on, {result['test']} for tests",
        f"  sizes       {', '.join(result['sizes'][:4])}{', ...' if len(result['sizes']) > 4 else ''}",
        f"  layout      {result['layout']}: {result['layout_reason']}",
        f"  background  {result['background']}",
        f"  bounds      [{', '.join(low)}] to [{', '.join(high)}], near {result['near']:.3g}, far {result['far']:.4g}",
    ]
    if result["points"]:
        lines.append(f"  points      {result['points']}")
    if result["truth_depths"]:
        lines.append(f"  truth       {result['truth_depths']} depth images")
    if result["skipped"]:
        names = ", ".join(result["skipped"][:5]) + (", ..." if len(result["skipped"]) > 5 else "")
        lines.append(f"  skipped     {len(result['skipped'])} ({'; '.join(result['skipped_why'])}): {names}")
    return lines
