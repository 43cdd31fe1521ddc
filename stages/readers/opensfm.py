"""OpenSfM's reconstruction.json, as OpenSfM and OpenDroneMap write it.

Shots are world-to-camera, rotation as angle times axis, with OpenCV axes. Focal lengths and principal points are in
units of the longer side, from the picture's center (OpenSfM, doc/source/geometry.rst), and its center is ours: with
pixel centers at whole numbers it is ((w - 1)/2, (h - 1)/2).
"""

import math
from pathlib import Path

import numpy as np

from schemas.errors import BadInput
from schemas.safe_names import printable
from schemas.safe_reading import read_json
from stages.readers import opensfm_file
from stages.readers.checked_values import entry_of, number, object_of, row, size
from stages.readers.listed_photos import Folder
from stages.readers.photo_folder import folder_of
from stages.readers.source import SourceCamera, SourcePoints, SourceScene, natural, with_masks
from stylerf.geometry.camera_conventions import from_colmap
from stylerf.geometry.distortion import Distortion

# By projection_type: the kind of distortion, its radial coefficients, whether it has two focal lengths and a center.
MODELS = {
    "perspective": ("brown", ("k1", "k2"), False),
    "simple_radial": ("brown", ("k1",), True),
    "radial": ("brown", ("k1", "k2"), True),
    "brown": ("brown", ("k1", "k2", "k3"), True),
    "fisheye": ("fisheye", ("k1", "k2"), False),
    "fisheye_opencv": ("fisheye", ("k1", "k2", "k3", "k4"), True),
}


def read(source: Path, images: str) -> SourceScene:
    """Read the shots of the reconstruction that has the most."""
    path = opensfm_file(source)
    if path is None:
        raise BadInput(f"{source} contains no OpenSfM reconstruction.json; run OpenSfM's `reconstruct`")
    parts = read_json(path)
    if not isinstance(parts, list) or not all(isinstance(one, dict) and "shots" in one for one in parts) or not parts:
        raise BadInput(f"{path} is not a list of OpenSfM reconstructions; run OpenSfM's `reconstruct` again")
    counts = [len(object_of(one, "shots", f"{path}: reconstruction {index}")) for index, one in enumerate(parts)]
    largest = int(np.argmax(counts))
    where = f"{path}: reconstruction {largest}"
    used = {str(entry_of(shot, "camera", where)) for shot in parts[largest]["shots"].values()}
    lenses = {
        key: _lens(camera, f"{path}: camera {printable(key)}")
        for key, camera in object_of(parts[largest], "cameras", where).items()
        if key in used
    }
    root = source.parent if source.is_file() else source
    photos = Folder(folder_of(root, images), root, str(path))
    cameras = [
        _camera(key, shot, lenses, photos, f"{path}: shot {printable(key)}")
        for key, shot in sorted(parts[largest]["shots"].items(), key=lambda item: natural(item[0]))
    ]
    if not cameras:
        raise BadInput(f"{path} contains no shot; run OpenSfM's `reconstruct` again")
    remarks = list(photos.remarks())
    if len(parts) > 1:
        others = ", ".join(str(count) for index, count in enumerate(counts) if index != largest)
        remarks.append(
            f"of {len(parts)} reconstructions the largest, of {counts[largest]} photos, is used (others: {others})"
        )
    return SourceScene(
        "reconstruction of OpenSfM", with_masks(cameras, root), _points(parts[largest], where),
        rescalable=bool(images), remarks=tuple(remarks), files=(path,),
    )  # fmt: skip


def _lens(camera: object, where: str):
    """(width, height), (fx, fy, cx, cy), distortion."""
    kind = str(entry_of(camera, "projection_type", where, "perspective"))
    if kind not in MODELS:
        raise BadInput(
            f"{where}: its projection {printable(kind)} is not supported; run OpenSfM's `undistort` and import the "
            "folder undistorted"
        )
    distortion, radial, brown = MODELS[kind]
    width, height = size(camera, where)
    longer = max(width, height)
    fx, fy = (number(camera, name, where) * longer for name in (("focal_x", "focal_y") if brown else ("focal",) * 2))
    cx, cy = (number(camera, name, where, 0.0) * longer if brown else 0.0 for name in ("c_x", "c_y"))
    p1, p2 = (number(camera, name, where, 0.0) if kind == "brown" else 0.0 for name in ("p1", "p2"))
    lens = Distortion(distortion, tuple(number(camera, name, where, 0.0) for name in radial), (p1, p2))
    return (width, height), (fx, fy, width / 2 + cx, height / 2 + cy), lens


def _camera(key: str, shot: object, lenses: dict, photos: Folder, where: str) -> SourceCamera:
    used = str(entry_of(shot, "camera", where))
    lens = lenses.get(used)
    if lens is None:
        raise BadInput(f"{where} has camera {printable(used)[:40]}, which is missing")
    rotation = _rotation(row(entry_of(shot, "rotation", where), 3, f"{where}: rotation"))
    shift = row(entry_of(shot, "translation", where), 3, f"{where}: translation")
    name, photo = photos.photo(key)
    return SourceCamera(
        name=name, source=key, image=photo, world_from_camera=from_colmap(np.column_stack([rotation, shift])),
        size=lens[0], intrinsics=lens[1], distortion=lens[2],
    )  # fmt: skip


def _rotation(vector: np.ndarray) -> np.ndarray:
    """[3, 3] of angle times axis (Rodrigues)."""
    angle = math.hypot(*vector)
    x, y, z = vector / angle if angle > 1e-12 else vector
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def _points(part: dict, where: str) -> SourcePoints | None:
    if not part.get("points"):
        return None
    entries = list(object_of(part, "points", where).values())
    try:
        xyz = np.array([one["coordinates"] for one in entries], dtype=np.float64)
        rgb = np.array([one.get("color", (128,) * 3) for one in entries], dtype=np.float64)
        if not xyz.shape == rgb.shape == (len(entries), 3):
            raise ValueError("not three numbers")
    except (TypeError, ValueError, KeyError, AttributeError, OverflowError) as error:
        raise BadInput(f"{where}: a point has no coordinates or no color of three numbers") from error
    kept = np.isfinite(np.hstack([xyz, rgb])).all(axis=1)
    if not kept.any():
        return None
    return SourcePoints(xyz[kept], rgb[kept].clip(0, 255).astype(np.uint8), np.zeros(int(kept.sum()), np.float32))
