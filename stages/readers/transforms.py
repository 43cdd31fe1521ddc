"""transforms.json of Blender / NeRF-synthetic, instant-ngp and nerfstudio."""

import json
import math
from dataclasses import replace
from pathlib import Path, PurePosixPath

import numpy as np

from schemas.errors import BadInput
from stages.readers.source import SourceCamera, SourceScene, bare, find_image, image_folder, with_masks
from stylerf.geometry.conventions import from_opengl, with_last_row
from stylerf.geometry.distortion import Distortion

_PINHOLES = ("PINHOLE", "SIMPLE_PINHOLE", "PERSPECTIVE", "OPENCV", "SIMPLE_RADIAL", "RADIAL")
_FISHEYES = ("OPENCV_FISHEYE", "FISHEYE")
LARGEST_SIDE = 1_000_000


def read(source: Path, images: str) -> SourceScene:
    """One transforms.json, or transforms_train.json and transforms_test.json (else _val) of a folder."""
    root = source.parent if source.is_file() else source
    cameras, kinds = [], set()
    for path, split in lists_of(source):
        content = _content(path)
        kinds.add(_kind(content))
        undo = _undo(content, path)
        told = _told_splits(content, path)
        for index, frame in enumerate(content["frames"]):
            cameras.append(_camera(root, path, content, frame, index, undo, told, split, images))
    if not cameras:
        raise BadInput(f"{source} lists no frames; export it again")
    kind = "nerfstudio" if "nerfstudio" in kinds else "instant-ngp" if "instant-ngp" in kinds else "Blender"
    return SourceScene(
        f"transforms.json of {kind}",
        with_masks(_distinct(cameras, root), root),
        keeps_frame=kind != "nerfstudio",
        rescalable=bool(images),
    )


def lists_of(source: Path) -> list[tuple[Path, str | None]]:
    """The files of frames that count, with the split of each where its name tells one."""
    if source.is_file():
        return [(source, None)]
    if (source / "transforms_train.json").is_file():
        files = [(source / "transforms_train.json", "train")]
        other = [source / f"transforms_{name}.json" for name in ("test", "val")]
        return files + [(path, "test") for path in other if path.is_file()][:1]
    if (source / "transforms.json").is_file():
        return [(source / "transforms.json", None)]
    return [(path, None) for path in sorted(source.glob("transforms*.json"))[:1]]


def _content(path: Path) -> dict:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise BadInput(f"{path} is no JSON ({error}); export it again") from error
    if not isinstance(content, dict) or not isinstance(content.get("frames"), list):
        raise BadInput(f"{path} has no list `frames`; expected a transforms.json of Blender, instant-ngp or nerfstudio")
    for index, frame in enumerate(content["frames"]):
        if not isinstance(frame, dict):
            raise BadInput(f"{path}: frame {index} is {frame!r:.40}, no object with file_path; export it again")
    return content


def _kind(content: dict) -> str:
    if {"camera_model", "applied_transform", "ply_file_path"} & content.keys():
        return "nerfstudio"
    first = content["frames"][0] if content["frames"] else {}
    return "instant-ngp" if {"fl_x", "w", "aabb_scale"} & (content.keys() | set(first)) else "Blender"


def _undo(content: dict, path: Path) -> np.ndarray:
    """[4, 4] back from nerfstudio's applied_transform to the frame that the cameras were found in."""
    if "applied_transform" not in content:
        return np.eye(4)
    applied = _matrix(content["applied_transform"], f"{path}: applied_transform")
    if abs(np.linalg.det(applied[:3, :3]) - 1) > 1e-3:
        raise BadInput(f"{path}: applied_transform is no rotation and shift; export it again")
    return np.linalg.inv(applied)


def _matrix(values: object, where: str) -> np.ndarray:
    try:
        matrix = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        matrix = np.empty(0)
    if matrix.shape not in ((3, 4), (4, 4)):
        raise BadInput(f"{where} is no 4x4 matrix; export it again")
    if not np.isfinite(matrix).all():
        raise BadInput(f"{where} holds NaN or infinity; repair it or remove the photo from the list")
    return with_last_row(matrix)


def _told_splits(content: dict, path: Path) -> dict[str, str]:
    told = {}
    for key, split in (("val_filenames", "test"), ("test_filenames", "test"), ("train_filenames", "train")):
        names = content.get(key, [])
        if not isinstance(names, list):
            raise BadInput(f"{path}: {key} is {names!r:.40}, expected a list of photos; export it again")
        told |= {str(name): split for name in names}
    return told


def _camera(root, path, content, frame, index, undo, told, split, images) -> SourceCamera:
    where = f"{path}: frame {index}"
    if not isinstance(frame.get("file_path"), str) or "transform_matrix" not in frame:
        raise BadInput(f"{where} lacks file_path or transform_matrix; export it again")
    listed = _listed(frame["file_path"])
    photo = _copy_in(image_folder(root, images), listed) if images else find_image(root / listed)
    numbers = _Numbers(content | frame, where)
    size, intrinsics, angle = _intrinsics(numbers)
    return SourceCamera(
        name=bare(listed).name,
        source=frame["file_path"],
        image=photo,
        world_from_camera=from_opengl(undo @ _matrix(frame["transform_matrix"], f"{where}: transform_matrix")),
        size=size,
        intrinsics=intrinsics,
        angle=angle,
        distortion=_distortion(numbers),
        split=split or told.get(frame["file_path"]),
        mask=_mask(root, frame, where) if photo else None,
        depth=_depth(root, bare(listed).name),
    )


def _depth(root: Path, name: str) -> Path | None:
    """True depth of the view of that name, where it is there."""
    path = PurePosixPath(name)
    found = root / "truth" / path.parent / f"depth_{path.name}.exr"
    return found if found.is_file() else None


def _mask(root: Path, frame: dict, where: str) -> Path | None:
    if not isinstance(frame.get("mask_path"), str):
        return None
    mask = root / _listed(frame["mask_path"])
    if not mask.is_file():
        raise BadInput(f"{where}: its mask {mask} is not there; restore it, or take mask_path out of the list")
    return mask


def _copy_in(folder: Path, listed: Path) -> Path | None:
    """The photo of another folder: by its listed path, by that without its first folders, at last by its name alone."""
    parts = [part for part in listed.parts if part not in ("..", listed.anchor)]
    places = (find_image(folder.joinpath(*parts[start:])) for start in range(len(parts)))
    return next(filter(None, places), None)


def _listed(path: str) -> Path:
    return Path(path.replace("\\", "/"))


class _Numbers:
    """Numbers of a frame, its own before those of the file; BadInput where one is no number."""

    def __init__(self, values: dict, where: str) -> None:
        self.values, self.where = values, where

    def get(self, key: str, default: float = math.nan) -> float:
        value = self.values.get(key, default)
        if not isinstance(value, int | float) or isinstance(value, bool):
            raise BadInput(f"{self.where}: {key} is {value!r}, expected a number; export it again")
        try:
            return float(value)
        except OverflowError as error:
            raise BadInput(f"{self.where}: {key} is beyond all numbers; export it again") from error

    def side(self, key: str) -> int:
        """A width or height in pixels."""
        value = self.get(key)
        if not 1 <= value < LARGEST_SIDE:
            raise BadInput(f"{self.where}: {key} is {value:g}, expected a size in pixels; export it again")
        return round(value)


def _intrinsics(numbers: _Numbers):
    """size or None, (fx, fy, cx, cy) or None, horizontal angle or None: what the frame tells of them."""
    has = numbers.values.keys()
    size = (numbers.side("w"), numbers.side("h")) if {"w", "h"} <= has else None
    if "fl_x" in has:
        fx = numbers.get("fl_x")
        return size, (fx, numbers.get("fl_y", fx), numbers.get("cx"), numbers.get("cy")), None
    if "camera_angle_x" not in has:
        raise BadInput(f"{numbers.where} tells neither fl_x nor camera_angle_x; export it with one of them")
    return size, None, numbers.get("camera_angle_x")


def _distortion(numbers: _Numbers) -> Distortion:
    model = str(numbers.values.get("camera_model", "OPENCV")).upper()
    if numbers.values.get("is_fisheye"):
        model = "OPENCV_FISHEYE"
    k = tuple(numbers.get(f"k{i}", 0.0) for i in range(1, 5))
    p = (numbers.get("p1", 0.0), numbers.get("p2", 0.0))
    if not all(map(math.isfinite, (*k, *p))):
        raise BadInput(f"{numbers.where}: a distortion coefficient is not finite; export it again")
    if model in _FISHEYES:
        return Distortion("fisheye", k)
    if model not in _PINHOLES:
        raise BadInput(
            f"{numbers.where}: its camera model {model} is not known; undistort the pictures first, or use one of "
            f"{', '.join(_PINHOLES + _FISHEYES)}"
        )
    return Distortion("brown", k, p)


def _distinct(cameras: list[SourceCamera], root: Path) -> list[SourceCamera]:
    """Names that occur in several folders get their folder in front, as train/r_0, and so does their true depth."""
    names, found = [camera.name for camera in cameras], []
    doubled = {name for name in names if names.count(name) > 1}
    for one in cameras:
        if one.name in doubled:
            name = str(bare(_listed(one.source))).lstrip("./")
            one = replace(one, name=name, depth=_depth(root, name))
        found.append(one)
    return found
