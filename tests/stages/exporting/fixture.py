"""Exports of small scenes by the stage itself."""

from pathlib import Path

from schemas.work_folder import Artifact, WorkFolder
from stages import export
from stages.configs.export import ExportConfig
from stages.run.progress import Context
from stages.run.runner import execute
from tests.stages.importing import Said


def exported(work: Path, inputs: dict[str, Artifact], said: Said | None = None, **options) -> Artifact:
    """The export of these inputs with these options."""
    config = export.pinned(ExportConfig(**options))
    context = Context(threads=1, progress=said or Said())
    return execute(export.SPEC, export.run, WorkFolder(work), "made", inputs, config, context, force=True)[0]
