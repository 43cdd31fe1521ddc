"""What a PATH on the command line is: a work folder, or one artifact in it."""

import shlex
from pathlib import Path

from schemas.errors import BadInput
from schemas.manifest import MANIFEST
from schemas.migrations import CURRENT
from schemas.work_folder import Artifact, WorkFolder


def work_or_artifact(path: Path) -> WorkFolder | Artifact:
    """The artifact whose folder or manifest `path` is, else the work folder there; BadInput where it is neither."""
    if path.name == MANIFEST:
        path = path.parent
    if not path.is_dir():
        raise BadInput(f"{path} is no folder; expected a work folder or an artifact such as WORK/scene/NAME")
    within = any((path / kind).is_dir() for kind in CURRENT)  # a work folder may itself lie in one called scene or edit
    if (path / MANIFEST).is_file() or (path.resolve().parent.name in CURRENT and not within):
        return Artifact(path.resolve())
    work = WorkFolder(path)
    if not work.artifacts() and not work.unfinished():
        raise BadInput(f"{path} holds no artifact; begin with: stylerf import PHOTOS {shlex.quote(str(path))}")
    return work


def work_around(artifact: Artifact) -> WorkFolder:
    """The work folder that an artifact stands in."""
    return WorkFolder(artifact.path.parent.parent)
