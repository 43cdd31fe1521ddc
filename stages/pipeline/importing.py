"""Import photos into a work folder."""

from dataclasses import asdict
from pathlib import Path

from schemas.errors import UsageError
from schemas.work_folder import Artifact
from stages.configs.pose_import import ImportConfig, ImportOptions
from stages.pipeline.prerequisites import photo_scenes
from stages.pipeline.stage_runner import Request, StageRunner

SCENE = "main"
_DEFAULTS = ImportOptions()


def imported(runner: StageRunner, source: Path, options: ImportOptions, request: Request) -> Artifact:
    """Import photos, with their poses or without.

    Raises:
        UsageError: the work folder already holds a scene of another name.
    """
    from stages import pose_import

    name = request.name or SCENE
    if others := [one.name for one in photo_scenes(runner.work) if one.name != name]:
        raise UsageError(
            f"{runner.work.root} already holds scene {others[0]}, and a work folder holds one scene: import into "
            f"another folder, or replace it with --name {others[0]}"
        )
    return runner.run(pose_import.SPEC, pose_import.run, {}, import_config(source, options), SCENE, request)


def import_config(source: Path, options: ImportOptions = _DEFAULTS) -> ImportConfig:
    """Return the options of an import with its source and the digest of its files, so that changes are noticed."""
    from stages.readers.digest import digest_of_source

    source = source.resolve()
    digest = digest_of_source(source, options.format, options.images)
    return ImportConfig(**asdict(options), source=str(source), source_digest=digest)
