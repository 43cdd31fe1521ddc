"""transforms.json of Blender / NeRF-synthetic, instant-ngp and nerfstudio. docs/import.md lists the supported keys."""

import os
import re
import unicodedata
from collections import Counter
from dataclasses import replace
from pathlib import Path, PurePosixPath, PureWindowsPath

import numpy as np

from schemas.errors import BadInput
from schemas.images import image_size
from schemas.safe_names import LONGEST_NAME, LONGEST_PATH, printable
from schemas.safe_reading import MOST_JSON, parsed, read_text
from stages.readers import split_lists, transforms_lens
from stages.readers.source import (
    SourceCamera,
    SourceScene,
    bare,
    find_image,
    image_folder,
    is_file,
    masks_beside,
    natural,
    with_masks,
)
from stages.readers.split_lists import Splits
from stages.readers.transforms_lens import Numbers
from stylerf.geometry.camera_conventions import ROTATION_TOLERANCE, from_mitsuba, from_opengl, with_last_row

_OF_FRAMES = {"file_path", "transform_matrix", "mask_path", *transforms_lens.KEYS}
_OF_FILES = {
    *("frames", "n_frames", "applied_transform", "applied_scale", "from_mitsuba", "normal_mts_args"),
    *transforms_lens.KEYS,
    *split_lists.KEYS,
}
# Keys that only configure another program's training, or place the scene, which here is placed by its cameras.
_NEEDLESS = {
    *("aabb", "aabb_scale", "render_aabb", "scale", "offset", "up", "orientation_override", "scene_scale"),
    *("sharpness", "sharpen", "importance_sampling", "n_extra_learnable_dims", "enable_depth_loading", "rotation"),
    *("enable_ray_loading", "integer_depth_scale", "depth_unit_scale_factor", "fovx", "fovy", "colmap_im_id"),
}


def read(source: Path, images: str) -> SourceScene:
    """One transforms.json, or transforms_train.json and transforms_test.json (else _val) of a folder."""
    root = source.parent if source.is_file() else source
    cameras, kinds, skipped, remarks = [], set(), [], _other_lists(source)
    taken: dict[Path, str] = {}
    for path, split in lists_of(source):
        content = _content(path)
        kinds.add(_kind(content))
        frames, left_out, lines = _frames(content, printable(str(path)), split)
        skipped += left_out
        remarks += lines
        reader = _Frames(root, printable(str(path)), content, images, taken)
        cameras += [reader.camera(index, frame, split) for index, frame, split in frames]
        remarks += reader.remarks(frames)
    remarks += [f"{count} frames left out: {why}" for why, count in Counter(why for _, why in skipped).items()]
    if not cameras:
        why = f"; {remarks[-1]}" if skipped else ""
        raise BadInput(f"{source} lists no frames to import{why}; repair the list or export it again")
    kind = "nerfstudio" if "nerfstudio" in kinds else "instant-ngp" if "instant-ngp" in kinds else "Blender"
    return SourceScene(
        f"transforms.json of {kind}",
        with_masks(_distinct(cameras, root), root),
        keeps_frame=kind != "nerfstudio",
        rescalable=bool(images),
        skipped=tuple(skipped),
        remarks=tuple(dict.fromkeys(remarks)),
    )


def lists_of(source: Path) -> list[tuple[Path, str | None]]:
    """Return the files of frames to read, with the split of each if its name has one."""
    if source.is_file():
        return [(source, None)]
    if (source / "transforms_train.json").is_file():
        other = [source / f"transforms_{name}.json" for name in ("test", "val")]
        tests = [path for path in other if path.is_file()][:1]
        return [(source / "transforms_train.json", "train"), *((path, "test") for path in tests)]
    if (source / "transforms.json").is_file():
        return [(source / "transforms.json", None)]
    return [(path, None) for path in sorted(source.glob("transforms*.json"))[:1]]


def _other_lists(source: Path) -> list[str]:
    """Return a line for the user if some lists are not read."""
    if source.is_file():
        return []
    read = {path.name for path, _ in lists_of(source)}
    others = sorted({path.name for path in source.glob("transforms*.json")} - read)
    if not others:
        return []
    names = ", ".join(map(printable, others[:5])) + (", ..." if len(others) > 5 else "")
    return [
        f"ignored in favor of {' and '.join(sorted(read))}: {names}; to use one, give its path instead of the folder"
    ]


def _content(path: Path) -> dict:
    shown = printable(str(path))
    try:
        text = read_text(path, MOST_JSON)
    except FileNotFoundError as error:
        raise BadInput(f"{shown} does not exist; restore it") from error
    try:
        content = parsed(text, shown)
    except BadInput:
        if (code := _without_comments(text)) == text:
            raise
        content = parsed(code, shown)
    if not isinstance(content, dict) or not isinstance(content.get("frames"), list):
        raise BadInput(
            f"{shown} has no `frames` list; expected a transforms.json of Blender, instant-ngp or nerfstudio"
        )
    for index, frame in enumerate(content["frames"]):
        if not isinstance(frame, dict):
            raise BadInput(
                f"{shown}: frame {index} is {printable(f'{frame!r:.40}')}, expected an object with file_path; export "
                "it again"
            )
    return content


def _without_comments(text: str) -> str:
    """Blank out // and /* */ comments, which instant-ngp allows, outside of strings, in linear time."""
    tokens = r'"(?:\\.?|[^"\\])*+(?:"|\Z)|//[^\n]*|/\*.*?(?:\*/|\Z)'
    return re.sub(tokens, lambda found: found[0] if found[0][0] == '"' else " ", text, flags=re.DOTALL)


def _kind(content: dict) -> str:
    if {"camera_model", "applied_transform", "ply_file_path"} & content.keys():
        return "nerfstudio"
    first = content["frames"][0] if content["frames"] else {}
    return "instant-ngp" if {"fl_x", "w", "aabb_scale"} & (content.keys() | set(first)) else "Blender"


def _frames(content: dict, path: str, split: str | None) -> tuple[list, list, list[str]]:
    """Return [(index, frame, split)] of the frames to use, [(photo, reason)] of the others, and remarks."""
    frames = list(enumerate(content["frames"]))
    for index, frame in frames:
        _check_frame(frame, f"{path}: frame {index}")
    splits = Splits(content, path)
    names = [frame["file_path"] for _, frame in frames]
    beyond = _beyond(content, names, path)
    skipped, kept = [], []
    for index, frame in frames:
        name = frame["file_path"]
        if index in beyond:
            skipped.append((name, "beyond n_frames of the list"))
        elif splits.left_out(name):
            skipped.append((name, "in no split list"))
        else:
            kept.append((index, frame, split or splits.of(name)))
    return kept, skipped, splits.remarks(names)


def _check_frame(frame: dict, where: str) -> None:
    if "transform_matrix_start" in frame and "transform_matrix" not in frame:
        raise BadInput(f"{where} has a rolling-shutter pose, which is not supported; add transform_matrix")
    if "file_path" not in frame or "transform_matrix" not in frame:
        raise BadInput(f"{where} lacks file_path or transform_matrix; export it again")
    _listed(frame["file_path"], f"{where}: file_path")


def _beyond(content: dict, names: list[str], path: str) -> set[int]:
    """Return the frames after the first n_frames by name, which instant-ngp leaves out."""
    if "n_frames" not in content:
        return set()
    count = Numbers(content, {}, path).get("n_frames")
    if not count >= 0:
        raise BadInput(f"{path}: n_frames is {count:g}, expected a number of frames; export it again")
    ordered = sorted(range(len(names)), key=lambda index: natural(names[index]))
    return set(ordered[int(min(count, len(names))) :])


def _listed(text: object, where: str) -> Path:
    """Return a listed path with forward slashes; BadInput if it is not a valid path."""
    path = text.replace("\\", "/") if isinstance(text, str) else ""
    parts = path.encode("utf-8", "replace").split(b"/")
    if not path.strip("./ ") or max(map(len, parts)) > LONGEST_NAME or sum(map(len, parts)) > LONGEST_PATH:
        raise BadInput(f"{where} is {printable(f'{text!r:.60}')}, expected the path of a picture; export it again")
    if printable(path) != path:
        raise BadInput(f"{where} is {printable(path)!r:.80}, which contains control characters; rename the picture")
    return Path(path)


class _Frames:
    """Turns the frames of one file into cameras, and collects remarks for the user.

    taken: listed path by photo, of all files of a source.
    """

    def __init__(self, root: Path, path: str, content: dict, images: str, taken: dict[Path, str]) -> None:
        self.root, self.path, self.content, self._taken = root, path, content, taken
        self.name = path.rpartition("/")[2]
        self.images = image_folder(root, images) if images else None
        self._undone, self._applied_scale = _undone(content, path)
        mitsuba = content.get("from_mitsuba", "normal_mts_args" in content)
        self._from_source = from_mitsuba if mitsuba else from_opengl
        self._scales: list[float] = []
        self._said: list[str] = []

    def camera(self, index: int, frame: dict, split: str | None) -> SourceCamera:
        """Return the camera of a frame; BadInput naming the frame if it is invalid."""
        where = f"{self.path}: frame {index}"
        listed = _listed(frame["file_path"], f"{where}: file_path")
        photo = self._photo(listed)
        if photo:
            self._take(photo, listed)
        numbers = Numbers(self.content, frame, where)
        intrinsics, angles = transforms_lens.intrinsics(numbers)
        size = self._size(numbers, listed, photo)
        if size and (odd := transforms_lens.disagreement(numbers, *size)):
            self._say(odd)
        return SourceCamera(
            name=bare(listed).name,
            source=frame["file_path"],
            image=photo,
            world_from_camera=self._pose(frame, where),
            size=size,
            intrinsics=intrinsics,
            angles=angles,
            distortion=transforms_lens.distortion(numbers),
            split=split,
            mask=self._mask(frame, where) if photo else None,
            depth=_depth(self.root, bare(listed).name),
        )

    def remarks(self, frames: list[tuple]) -> list[str]:
        """Return what was ignored or interpreted, one line each."""
        unread = {key: len(frames) for key in self.content.keys() - _OF_FILES - _NEEDLESS}
        for _, frame, _ in frames:
            for key in frame.keys() - _OF_FRAMES - _NEEDLESS:
                unread[key] = unread.get(key, 0) + 1
        if unread:
            keys = sorted(unread)
            names = ", ".join(printable(key)[:40] for key in keys[:8]) + (", ..." if len(keys) > 8 else "")
            self._say(f"{self.name}: not used: {names}")
        if self._scales:
            self._say(
                f"{self.name}: the matrices of {len(self._scales)} frames are scaled, by {min(self._scales):.4g} to "
                f"{max(self._scales):.4g}: only their rotations are used"
            )
        return list(dict.fromkeys(self._said))[:8]

    def _say(self, line: str) -> None:
        if len(self._said) < 100:
            self._said.append(line)

    def _photo(self, listed: Path) -> Path | None:
        if self.images:
            return _copy_in(self.images, listed)
        return self._found(listed)

    def _take(self, photo: Path, listed: Path) -> None:
        """Reject a photo that another listed path also resolves to: it shows what only one of the cameras saw."""
        path = unicodedata.normalize("NFC", os.path.normpath(bare(listed)))
        if (other := self._taken.setdefault(photo, path)) != path:
            raise BadInput(
                f"{self.path}: {printable(other)} and {printable(path)} would both be the photo {photo}; put the "
                "photos in folders as the list has them"
            )

    def _found(self, listed: Path) -> Path | None:
        """Find the photo at its listed path; for an absolute path from another machine, by the end of the path."""
        if found := find_image(self.root / listed):
            if not Path(os.path.abspath(found)).is_relative_to(os.path.abspath(self.root)):
                self._say(f"{self.name}: using pictures outside its folder: {printable(str(listed))}")
            for companion in (f"{found.stem}.alpha{found.suffix}", f"{found.name}.alpha{found.suffix}"):
                if is_file(found.parent / companion):
                    self._say(
                        f"{self.name}: not used: separate alpha files next to photos, such as {printable(companion)}"
                    )
            return found
        if not (listed.is_absolute() or PureWindowsPath(listed).drive):
            return None
        if found := _copy_in(self.root, listed):
            self._say(f"{self.name}: looking for its photos next to it by the ends of their paths")
        return found

    def _size(self, numbers: Numbers, listed: Path, photo: Path | None) -> tuple[int, int] | None:
        """Return the size that the intrinsics refer to; a missing side is the listed photo's."""
        width, height = numbers.side("w"), numbers.side("h")
        if width and height:
            return width, height
        original = self._found(listed) if self.images else photo
        if original and (width or height or self.images):
            there = image_size(original, upright=False)
            return width or there[0], height or there[1]
        if self.images and photo and any(map(numbers.has, ("fl_x", "fl_y", "cx", "cy"))):
            self._say(f"{self.name} has no w and h: assuming that its lens is that of the photos in --images")
        return None

    def _pose(self, frame: dict, where: str) -> np.ndarray:
        matrix = _matrix(frame["transform_matrix"], f"{where}: transform_matrix")
        lengths = np.linalg.norm(matrix[:3, :3], axis=0)
        mean = float(lengths.mean())
        # A common scale of all three axes preserves directions: instant-ngp and nerfstudio do not notice it.
        if mean > 0 and np.ptp(lengths) < ROTATION_TOLERANCE * mean and abs(mean - 1) > ROTATION_TOLERANCE / 2:
            matrix[:3, :3] /= mean
            self._scales.append(mean)
        matrix[:3, 3] /= self._applied_scale
        return self._from_source(self._undone @ matrix)

    def _mask(self, frame: dict, where: str) -> Path | None:
        """Return the mask that a frame names; for photos in images_2, the one in masks_2."""
        if frame.get("mask_path") is None:
            return None
        listed = _listed(frame["mask_path"], f"{where}: mask_path")
        if self.images and self.images.name.startswith("images_"):
            smaller = self.images.parent / masks_beside(self.images.name)
            if smaller.is_dir() and (mask := _copy_in(smaller, listed)):
                return mask
        mask = self._found(listed)
        if mask is None:
            raise BadInput(
                f"{where}: its mask {self.root / listed} does not exist; restore it, or remove mask_path from the list"
            )
        return mask


def _undone(content: dict, path: str) -> tuple[np.ndarray, float]:
    """Return the [4, 4] inverse of nerfstudio's applied_transform, and applied_scale, which then scaled the camera
    centers."""
    scale = Numbers(content, {}, path).get("applied_scale", 1.0)
    if not (np.isfinite(scale) and scale > 0):
        raise BadInput(f"{path}: applied_scale is {scale:g}, expected a positive number; export it again")
    undone = np.eye(4)
    if "applied_transform" in content:
        applied = _matrix(content["applied_transform"], f"{path}: applied_transform")
        if abs(np.linalg.det(applied[:3, :3]) - 1) > 1e-3:
            raise BadInput(f"{path}: applied_transform is not a rotation and shift; export it again")
        undone = np.linalg.inv(applied)
    return undone, scale


def _matrix(values: object, where: str) -> np.ndarray:
    try:
        matrix = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError, RecursionError):
        matrix = np.empty(0)
    if matrix.shape not in ((3, 4), (4, 4)):
        raise BadInput(f"{where} is not a 4x4 matrix; export it again")
    if not np.isfinite(matrix).all():
        raise BadInput(f"{where} contains NaN or infinity; repair it or remove the photo from the list")
    if len(matrix) == 4 and not np.allclose(matrix[3], [0, 0, 0, 1], rtol=0, atol=1e-6):
        raise BadInput(f"{where} has {matrix[3].tolist()} as its last row, expected 0 0 0 1; is it transposed?")
    return with_last_row(matrix)


def _depth(root: Path, name: str) -> Path | None:
    """Return the file of true depth of the view, if it exists."""
    path = PurePosixPath(name)
    found = root / "truth" / path.parent / f"depth_{path.name}.exr"
    return found if is_file(found) else None


def _copy_in(folder: Path, listed: Path) -> Path | None:
    """Find the photo in another folder: by its listed path, without leading folders, finally by name."""
    parts = [part for part in listed.parts if part not in ("..", listed.anchor)]
    places = (find_image(folder.joinpath(*parts[start:])) for start in range(len(parts)))
    return next(filter(None, places), None)


def _distinct(cameras: list[SourceCamera], root: Path) -> list[SourceCamera]:
    """Prefix names that occur in several folders with their folder, as train/r_0, as for their true depth."""
    counts, found = Counter(camera.name for camera in cameras), []
    for one in cameras:
        if counts[one.name] > 1:
            name = str(bare(_listed(one.source, "file_path"))).lstrip("./")
            one = replace(one, name=name, depth=_depth(root, name))
        found.append(one)
    return found
