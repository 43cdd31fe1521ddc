"""PATH arguments: a work folder, or an artifact in one."""

import shlex
from pathlib import Path

from schemas.errors import BadInput
from schemas.manifest import MANIFEST
from schemas.migrations import CURRENT
from schemas.work_folder import Artifact, WorkFolder


def work_or_artifact(path: Path) -> WorkFolder | Artifact:
    """Return the artifact whose folder or manifest `path` is, else the work folder; BadInput if it is neither."""
    if path.name == MANIFEST:
        path = path.parent
    if not path.is_dir():
        raise BadInput(f"{path} is not a folder; expected a work folder or an artifact such as WORK/scene/NAME")
    within = any((path / kind).is_dir() for kind in CURRENT)  # the work folder's parent may be called scene or edit
    if (path / MANIFEST).is_file() or (path.resolve().parent.name in CURRENT and not within):
        return Artifact(path.resolve())
    work = WorkFolder(path)
    if not work.artifacts() and not work.unfinished():
        raise BadInput(f"{path} contains no artifact; start with: stylerf import PHOTOS {shlex.quote(str(path))}")
    return work


def work_around(artifact: Artifact) -> WorkFolder:
    """Return the work folder that holds an artifact."""
    return WorkFolder(artifact.path.parent.parent)
