"""LLFF's poses_bounds.npy: one row per photo, in the alphabetical order of the photos' names."""

import io
import math
from pathlib import Path
from tokenize import TokenError

import numpy as np

from schemas.errors import BadInput
from schemas.safe_names import printable
from schemas.safe_reading import read_bytes
from stages.readers.source import SourceCamera, SourceScene, image_folder, images_in, path_in_source, with_masks
from stylerf.geometry.camera_conventions import from_llff

MOST_BYTES = 64 << 20  # of poses of 400,000 photos
FOLDERS = ("images", "images_2", "images_4", "images_8")


def read(source: Path, images: str) -> SourceScene:
    """Read a folder with poses_bounds.npy, [n, 17]: 3x5 of pose and (height, width, focal) of the full-size photos, and
    nearest and farthest depth."""
    path = source if source.is_file() else source / "poses_bounds.npy"
    rows = _rows(path)
    folder = image_folder(path.parent, images) if images else _default_folder(path.parent)
    # LLFF and its successors sort names letter by letter, 10 before 2.
    photos = sorted(images_in(folder), key=lambda photo: photo.name)
    if len(photos) != len(rows):
        raise BadInput(
            f"{path} has {len(rows)} poses but {folder} has {len(photos)} photos; LLFF identifies photos only by "
            "their order, so the numbers must match: restore or remove photos, or name their folder with --images"
        )
    cameras = []
    for row, photo in zip(rows, photos, strict=True):
        pose = row[:15].reshape(3, 5)
        height, width, focal = pose[:, 4]
        if not (np.isfinite(pose[:, 4]).all() and min(height, width) >= 1):
            raise BadInput(
                f"{path}: the row of {photo.name} has an invalid size of {width:g}x{height:g}; export it again"
            )
        cameras.append(
            SourceCamera(
                name=photo.stem,
                source=path_in_source(photo, path.parent),
                image=photo,
                world_from_camera=from_llff(pose),
                size=(round(width), round(height)),
                intrinsics=(focal, focal, width / 2, height / 2),
                near_far=(float(row[15]), float(row[16])),
            )
        )
    cameras = with_masks(cameras, path.parent)
    return SourceScene(f"LLFF poses_bounds.npy with photos of {folder.name}", cameras, rescalable=True)


def _rows(path: Path) -> np.ndarray:
    try:
        data = read_bytes(path, MOST_BYTES)
    except FileNotFoundError as error:
        raise BadInput(f"{path} not found; restore it") from error
    try:
        rows = _array(data)
    except (ValueError, EOFError, RecursionError, MemoryError, SyntaxError, TypeError, TokenError) as error:
        reason = printable(str(error)).splitlines() or ["damaged"]
        raise BadInput(f"{path} cannot be read ({reason[0]}); export it again") from error
    if rows.ndim != 2 or rows.shape[1] != 17 or rows.dtype.kind not in "fi" or not len(rows):
        raise BadInput(f"{path} is an array of shape {rows.shape}; expected n x 17")
    bad = ~np.isfinite(rows[:, 15:]).all(axis=1) | (rows[:, 15] <= 0) | (rows[:, 16] <= rows[:, 15])
    if bad.any():
        raise BadInput(
            f"{path}: row {int(np.argmax(bad))} has invalid depth bounds {rows[np.argmax(bad), 15:].tolist()}"
        )
    return rows.astype(np.float64)


def _array(data: bytes) -> np.ndarray:
    """Return the array of a .npy file; ValueError for other files, objects, or a shape that its bytes do not match."""
    if data[:6] != b"\x93NUMPY":
        found = "a zip archive like .npz" if data[:2] == b"PK" else "not a .npy file"
        raise ValueError(f"it is {found}; expected one array saved by numpy.save")
    stream = io.BytesIO(data)
    version = np.lib.format.read_magic(stream)
    header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, kind = header(stream)
    if math.prod(shape) * kind.itemsize > len(data):  # before numpy allocates memory for it
        raise ValueError(f"truncated: its header declares {shape} numbers")
    return np.lib.format.read_array(io.BytesIO(data), allow_pickle=False)


def _default_folder(root: Path) -> Path:
    for name in FOLDERS:
        if (root / name).is_dir() and images_in(root / name):
            return root / name
    raise BadInput(f"{root} has no photos in {', '.join(FOLDERS)}; name their folder with --images")
