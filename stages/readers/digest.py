"""The identity of a source: the content of what an import reads, wherever it lies and whenever it was written."""

from pathlib import Path

import numpy as np

from schemas.canonical import digest_of, file_sha256
from schemas.errors import BadInput
from stages.readers import detected, model_folders, read_source
from stages.readers.photo_folder import photos_of, unreadable_beside
from stages.readers.source import SourceCamera, told, with_masks
from stages.readers.transforms import lists_of


def digest_of_source(source: Path, format: str = "auto", images: str = "") -> str:
    """SHA-256 over the files that tell poses and over every photo, its mask and its known depth, each under the name
    that the source has for it. What else lies there does not count. BadInput where the source cannot be read.
    """
    if not source.exists():
        raise BadInput(f"{source} does not exist; give a folder of photos with poses")
    kind = next(iter(detected(source)), "photos") if format == "auto" else format
    if kind == "photos":
        photos = photos_of(source, images)
        cameras = with_masks([SourceCamera(one.stem, told(one, source), one, np.eye(4)) for one in photos], source)
        others = [one.name for one in unreadable_beside(photos)]
        return digest_of([kind, others, [_entry(one) for one in cameras]])
    cameras = read_source(source, kind, images).cameras
    poses = [[path.name, _content(path)] for path in _files_of_poses(source, kind)]
    return digest_of([kind, poses, [_entry(one) for one in cameras]])


def _files_of_poses(source: Path, kind: str) -> list[Path]:
    if kind == "transforms":
        return [path for path, _ in lists_of(source)]
    if kind == "llff":
        return [source if source.is_file() else source / "poses_bounds.npy"]
    names = [f"{name}{end}" for name in ("cameras", "images", "points3D") for end in (".bin", ".txt")]
    places = [folder / name for folder in model_folders(source) for name in names]
    return [place for place in places if place.is_file()]


def _entry(camera: SourceCamera) -> list:
    files = [camera.image, camera.mask, camera.depth, *filter(None, [camera.hides])]
    return [camera.source, *(one and _content(one) for one in files)]


def _content(path: Path) -> str:
    try:
        return file_sha256(path)
    except OSError as error:
        raise BadInput(f"{path} cannot be read ({error.strerror}); restore it or its permissions") from error
