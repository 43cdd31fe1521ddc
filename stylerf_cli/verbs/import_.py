"""`stylerf import SOURCE WORK`: photos, with poses or without, into a scene."""

from dataclasses import asdict
from pathlib import Path

from schemas.errors import UsageError
from stages.configs.pose_import import ImportConfig, ImportOptions

NAME = "import"
HELP = "bring photos into a work folder, with their camera poses"
CONFIG = ImportOptions
SCENE = "main"
_DEFAULTS = ImportOptions()


def add_arguments(parser) -> None:
    """SOURCE and WORK."""
    parser.add_argument("source", type=Path, metavar="SOURCE", help="folder of photos, alone or with poses of "
                        "transforms.json, COLMAP, LLFF, Metashape, OpenSfM, Polycam or Record3D")  # fmt: skip
    parser.add_argument("work", type=Path, metavar="WORK", help="work folder of one scene, made where there is none")


def run(args, session) -> dict:
    """{"scene": name, "path", "digest", "seconds", ...figures of the import}."""
    from stages import pose_import

    _refuse_a_second(session.work, session.name or SCENE)
    config = config_for(args.source, session.config)
    artifact = session.run(pose_import.SPEC, pose_import.run, {}, config, SCENE)
    figures = artifact.manifest.figures
    result = {
        "scene": artifact.name, "path": artifact.path, "digest": artifact.digest,
        "seconds": artifact.manifest.seconds, **figures,
    }  # fmt: skip
    return session.emit(result, _words(result))


def _refuse_a_second(work, name: str) -> None:
    """UsageError where a scene of another name stands; those that `distill` made do not count."""
    others = [one for one in work.artifacts("scene") if one.name != name and one.manifest.stage != "distill"]
    if others:
        raise UsageError(
            f"{work.root} holds scene {others[0].name} already, and a work folder holds one scene: import into another "
            f"folder, or replace it with --name {others[0].name}"
        )


def config_for(source: Path, options: ImportOptions = _DEFAULTS) -> ImportConfig:
    """The options of an import with its source and the source's digest, so that changed photos are seen."""
    from stages.readers.digest import digest_of_source

    source = source.resolve()
    digest = digest_of_source(source, options.format, options.images)
    return ImportConfig(**asdict(options), source=str(source), source_digest=digest)


def _words(result: dict) -> list[str]:
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
