"""The identity of a source: the content of the files that an import reads, regardless of place and date."""

from pathlib import Path

import numpy as np

from schemas.canonical_json import digest_of, file_sha256
from schemas.errors import BadInput
from stages.readers import found_in, read_source
from stages.readers.photo_folder import photos_of, unreadable_beside
from stages.readers.source import SourceCamera, path_in_source, with_masks
from stages.readers.transforms import lists_of


def digest_of_source(source: Path, format: str = "auto", images: str = "") -> str:
    """SHA-256 of the files with poses and of every photo, its mask and its known depth, each by its name in the source.
    Other files do not count. BadInput if the source cannot be read.
    """
    kind = found_in(source, format).kind
    if kind == "photos":
        photos = photos_of(source, images)
        plain = [SourceCamera(one.stem, path_in_source(one, source), one, np.eye(4)) for one in photos]
        cameras = with_masks(plain, source)
        others = [one.name for one in unreadable_beside(photos)]
        return digest_of([kind, others, [_entry(one) for one in cameras]])
    scene = read_source(source, format, images)
    poses = [[path.name, _content(path)] for path in scene.files or _files_of_poses(source, kind)]
    return digest_of([kind, poses, [_entry(one) for one in scene.cameras]])


def _files_of_poses(source: Path, kind: str) -> list[Path]:
    if kind == "transforms":
        return [path for path, _ in lists_of(source)]
    return [source if source.is_file() else source / "poses_bounds.npy"]


def _entry(camera: SourceCamera) -> list:
    files = [camera.image, camera.mask, camera.depth, *filter(None, [camera.hides])]
    return [camera.source, *(one and _content(one) for one in files)]


def _content(path: Path) -> str:
    try:
        return file_sha256(path)
    except OSError as error:
        raise BadInput(f"{path} cannot be read ({error.strerror}); restore it or its permissions") from error
