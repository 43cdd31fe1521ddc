"""Export: meshes, splats, cameras and whole shots, in the formats of other programs.

Roles of the inputs: `scene` and, for all but cameras, `field`.
"""

import importlib
from dataclasses import replace
from pathlib import Path

from schemas.atomic_write import write_json
from schemas.work_folder import Artifact, PartialArtifact
from stages.artifacts.camera_files import digest_of_cameras
from stages.configs.export import ExportConfig
from stages.configs.render import OWN_VIEWS
from stages.exporting.job import ExportedFile, ExportJob
from stages.exporting.libraries import check_formats
from stages.run.progress import Context
from stages.run.runner import Spec
from stylerf.geometry.camera_paths import PATHS
from stylerf.kernels.cpu.compiling import set_threads

EXPORT_FILE = "export.json"
SPEC = Spec(
    stage="export", verb="export", revision=2, writes="export",
    outside=lambda config: {"path_digest": digest_of_cameras(Path(config.along))} if config.path_digest else {},
)  # fmt: skip


def run(inputs: dict[str, Artifact], config: ExportConfig, partial: PartialArtifact, context: Context) -> dict:
    """Write the files of each format, and export.json, which says what their coordinates are; return the figures."""
    check_formats(config.kind, config.chosen)
    job = ExportJob(inputs, config, partial.path, replace(context, threads=set_threads(context.threads)))
    files, figures = importlib.import_module(f"stages.exporting.{config.kind}").write(job)
    write_json(partial.path / EXPORT_FILE, {
        "kind": config.kind, "units": config.units, "files": [_described(one) for one in files],
    })  # fmt: skip
    return {"files": [one.path for one in files], **figures}


def pinned(config: ExportConfig) -> ExportConfig:
    """Add the digest of the camera file, so that changes are noticed."""
    path = Path(config.along)
    known = config.along in ("", *OWN_VIEWS, *PATHS) or not path.exists()
    return replace(config, path_digest="" if known else digest_of_cameras(path))


def _described(one: ExportedFile) -> dict:
    return {"path": one.path, "up": one.up, "file_from_scene": one.file_from_scene.tolist(), **one.notes}
