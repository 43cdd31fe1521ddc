"""Polycam's raw data (developer mode): one JSON file per keyframe.

t_00 to t_23 are the rows of camera-to-world with ARKit's axes, x right, y up, z backward; fx, fy, cx, cy are pixels.
The cameras that Polycam has optimized (corrected_cameras) have separate pictures (corrected_images).
"""

from pathlib import Path

import numpy as np

from schemas.errors import BadInput
from schemas.safe_names import printable
from schemas.safe_reading import read_json
from stages.readers import POLYCAM, keyframes_in, polycam_folder
from stages.readers.checked_values import number, size
from stages.readers.listed_photos import Folder
from stages.readers.source import SourceCamera, SourceScene, image_folder, natural, with_masks
from stylerf.geometry.camera_conventions import from_opengl, with_last_row

MOST_BYTES = 1 << 20


def read(source: Path, images: str) -> SourceScene:
    """Read all keyframes, optimized ones if available."""
    folder = polycam_folder(source)
    if folder is None:
        raise BadInput(f"{source} contains no Polycam keyframes; export its raw data")
    pairs = [(folder / cameras, folder / photos) for cameras, photos in POLYCAM]
    of_cameras, of_photos = next((a, b) for a, b in pairs if b.is_dir() and keyframes_in(a))
    photos = Folder(image_folder(source, images) if images else of_photos, None, str(of_cameras))
    files = sorted(keyframes_in(of_cameras), key=lambda path: natural(path.name))
    cameras = [_camera(path, photos) for path in files]
    return SourceScene(
        f"keyframes of Polycam ({of_cameras.name})", with_masks(cameras, source), rescalable=bool(images),
        remarks=photos.remarks(), files=tuple(files),
    )  # fmt: skip


def _camera(path: Path, photos: Folder) -> SourceCamera:
    content, where = read_json(path, limit=MOST_BYTES), printable(str(path))
    pose = [[number(content, f"t_{i}{j}", where) for j in range(4)] for i in range(3)]
    fx, fy, cx, cy = (number(content, name, where) for name in ("fx", "fy", "cx", "cy"))
    name, photo = photos.photo(path.stem)
    return SourceCamera(
        name=name, source=path.stem, image=photo, world_from_camera=from_opengl(with_last_row(np.array(pose))),
        size=size(content, where), intrinsics=(fx, fy, cx, cy),
    )  # fmt: skip
