"""Record3D's metadata.json next to rgb/ or rgbd/: one pose per frame.

A pose is (qx, qy, qz, qw, x, y, z), camera-to-world with ARKit's axes, x right, y up, z backward. K is 3x3, column by
column; perFrameIntrinsicCoeffs, if present, are (fx, fy, cx, cy) of each frame. Frame N is N.jpg.
"""

import math
from pathlib import Path

import numpy as np

from schemas.errors import BadInput
from schemas.safe_reading import read_json
from stages.readers import record3d_file
from stages.readers.checked_values import entry_of, row, size
from stages.readers.colmap_model import ROUNDING, rotation_of
from stages.readers.source import SourceCamera, SourceScene, image_folder, images_in, path_in_source, with_masks
from stylerf.geometry.camera_conventions import from_opengl, with_last_row


def read(source: Path, images: str) -> SourceScene:
    """Return the frames that have a photo, named by number."""
    path = record3d_file(source)
    if path is None:
        raise BadInput(f"{source} contains no Record3D metadata.json next to rgb or rgbd; export it as EXR + RGB")
    content, root = read_json(path), path.parent
    poses = entry_of(content, "poses", str(path))
    if not isinstance(poses, list) or not poses:
        raise BadInput(f"{path}: poses is not a list of poses; export the recording again")
    places = (root / name for name in ("rgb", "rgbd", ""))
    folder = image_folder(root, images) if images else next(place for place in places if place.is_dir())
    photos = {int(photo.stem): photo for photo in images_in(folder) if photo.stem.isascii() and photo.stem.isdecimal()}
    if not photos:
        raise BadInput(f"{folder} contains no Record3D frames (0.jpg, 1.jpg, ...); name their folder with --images")
    if max(photos) >= len(poses):
        raise BadInput(f"{path} has {len(poses)} poses, too few for {photos[max(photos)]} (frames count from 0)")
    intrinsics = _intrinsics(content, len(poses), str(path))
    cameras = [
        SourceCamera(
            name=photo.stem, source=path_in_source(photo, root), image=photo, size=size(content, str(path), ("w", "h")),
            world_from_camera=from_opengl(_pose(poses[number], f"{path}: pose {number}")),
            intrinsics=intrinsics[number],
        )
        for number, photo in sorted(photos.items())
    ]  # fmt: skip
    remarks = (f"{len(poses) - len(photos)} of {len(poses)} frames have no photo",) if len(photos) < len(poses) else ()
    return SourceScene(
        "recording of Record3D", with_masks(cameras, root), rescalable=bool(images), remarks=remarks, files=(path,)
    )


def _intrinsics(content: object, count: int, where: str) -> list[tuple[float, float, float, float]]:
    """fx, fy, cx, cy of every frame."""
    each = entry_of(content, "perFrameIntrinsicCoeffs", where, [])
    if isinstance(each, list) and len(each) == count:
        rows = (row(one, 4, f"{where}: perFrameIntrinsicCoeffs {index}").tolist() for index, one in enumerate(each))
        return [(fx, fy, cx, cy) for fx, fy, cx, cy in rows]
    k = row(entry_of(content, "K", where), 9, f"{where}: K").reshape(3, 3).T
    return [(float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2]))] * count


def _pose(values: object, where: str) -> np.ndarray:
    x, y, z, w, *center = row(values, 7, where)
    length = math.hypot(w, x, y, z)
    if abs(length - 1) > ROUNDING:
        raise BadInput(f"{where}: its quaternion has length {length:.3g}, expected 1")
    return with_last_row(np.column_stack([rotation_of(np.array([w, x, y, z]) / length), center]))
