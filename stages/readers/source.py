"""The result of every pose reader: the source's cameras, with our axes but in the source's frame."""

import errno
import math
import os
import unicodedata
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from schemas.errors import BadInput
from stylerf.geometry.distortion import Distortion


@dataclass(frozen=True, eq=False)
class SourceCamera:
    """One photo and its camera.

    Attributes:
        name: Name of the view.
        source: Path of the photo as the source lists it.
        image: The file; None if none exists.
        world_from_camera: [4, 4], OpenCV axes, source units.
        size: (width, height) that the intrinsics refer to; None: the size of the photo.
        intrinsics: fx, fy, cx, cy in pixels. A focal length of NaN follows from its angle or else from the other axis;
            a principal point of NaN is the center.
        angles: Horizontal and vertical field of view in radians, NaN if unknown.
        split: train, test or None if unknown.
        mask: Picture whose white pixels are kept.
        hides: Picture whose pixels other than black are hidden.
        near_far: Range of planar depths that this camera sees, source units.
    """

    name: str
    source: str
    image: Path | None
    world_from_camera: np.ndarray
    size: tuple[int, int] | None = None
    intrinsics: tuple[float, float, float, float] = (math.nan,) * 4
    angles: tuple[float, float] = (math.nan, math.nan)
    distortion: Distortion = field(default_factory=Distortion)
    split: str | None = None
    mask: Path | None = None
    hides: Path | None = None
    depth: Path | None = None
    near_far: tuple[float, float] | None = None

    @property
    def photo(self) -> Path:
        """The file; BadInput if none exists."""
        if self.image is None:
            raise BadInput(f"{self.source} has no image file; restore it")
        return self.image


@dataclass(frozen=True, eq=False)
class SourcePoints:
    """Sparse points in the source's frame: xyz [n, 3] float64, rgb [n, 3] uint8, error [n] float32 pixels."""

    xyz: np.ndarray
    rgb: np.ndarray
    error: np.ndarray


@dataclass(frozen=True, eq=False)
class SourceScene:
    """Everything that a source contains.

    Attributes:
        kind: The format, for the user.
        files: Files with the poses, if the reader lists them.
        keeps_frame: The frame is that of a synthetic scene and should be kept.
        rescalable: Photos may be smaller copies of those that the intrinsics refer to.
        upright: Cameras refer to the photos as EXIF orients them, otherwise as stored.
        sfm: Figures of a reconstruction.
        skipped: (photo, reason) of photos that the reader left out.
        remarks: Lines for the user about what the reader ignored or interpreted.
    """

    kind: str
    cameras: list[SourceCamera]
    points: SourcePoints | None = None
    files: tuple[Path, ...] = ()
    keeps_frame: bool = False
    rescalable: bool = False
    upright: bool = False
    sfm: dict | None = None
    skipped: tuple[tuple[str, str], ...] = ()
    remarks: tuple[str, ...] = ()


_DYNAMIC = "dynamic_mask_"
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp", ".bmp", ".jp2", ".exr", ".hdr")


def bare(path: Path) -> Path:
    """Return the path without the suffix of an image; frame.0001 keeps its number."""
    return path.with_suffix("") if path.suffix.lower() in IMAGE_SUFFIXES else path


def is_file(path: Path) -> bool:
    """Return path.is_file(), and False for a name too long for the file system, where that may be an OSError."""
    try:
        return path.is_file()
    except OSError as error:
        if error.errno != errno.ENAMETOOLONG:
            raise
        return False


def find_image(path: Path) -> Path | None:
    """Return the file at `path`, or the image of that name if the suffix is missing or of another case, or if accents
    are composed differently; None if there is none."""
    parts, spelled = path.parts, {path: None}
    for start in reversed(range(len(parts))):  # parent folders may be spelled differently than those below
        for form in ("NFC", "NFD"):
            spelled[Path(*parts[:start], *(unicodedata.normalize(form, part) for part in parts[start:]))] = None
    return next(filter(None, map(_spelled_so, spelled)), None)


def _spelled_so(path: Path) -> Path | None:
    if path.suffix.lower() in IMAGE_SUFFIXES:
        for suffix in (path.suffix, path.suffix.lower(), path.suffix.upper()):
            if is_file(candidate := path.with_suffix(suffix)):
                return candidate
    for suffix in IMAGE_SUFFIXES:
        for candidate in (Path(f"{path}{suffix}"), Path(f"{path}{suffix.upper()}")):
            if is_file(candidate):
                return candidate
    return path if is_file(path) else None


def with_masks(cameras: list[SourceCamera], root: Path) -> list[SourceCamera]:
    """Add masks that the source does not list: in root/masks or beside the photo, and instant-ngp's
    dynamic_mask_NAME.png.

    Raises:
        BadInput: A mask could belong to either of two photos.
    """
    found: list[SourceCamera] = []
    photos: dict[Path, Path] = {}
    for one in cameras:
        if one.image:
            hides = one.image.parent / f"{_DYNAMIC}{one.image.stem}.png"
            one = replace(one, hides=hides) if is_file(hides) else one
        if one.image and not one.mask and (mask := _mask_of(one.image, root)):
            other = photos.setdefault(mask, one.image)
            if os.path.normpath(other.parent) != os.path.normpath(one.image.parent):
                raise BadInput(
                    f"{mask} could be the mask of {other} or of {one.image}; put masks in folders named like those of "
                    "the photos"
                )
            one = replace(one, mask=mask)
        found.append(one)
    return found


def _mask_of(image: Path, root: Path) -> Path | None:
    """Find the mask of images_2/a/1.jpg: in masks_2/a, masks/images_2/a, masks/a or masks, else a/1_mask.png."""
    try:
        inner = Path(os.path.relpath(image.parent, root))
    except ValueError:  # on Windows, if the photo is on another drive
        inner = image.parent.relative_to(image.parent.anchor)
    above = [part for part in inner.parts if part != ".."]
    folders = [root.joinpath("masks", *above[start:]) for start in range(len(above) + 1)]
    for place, part in enumerate(above):
        if part.startswith("images_"):
            folders.insert(0, root.joinpath(masks_beside(part), *above[place + 1 :]))
    beside = image.parent / f"{image.stem}_mask.png"
    there = (_mask_in(folder, image) for folder in folders if folder.is_dir())
    return next(filter(None, there), beside if is_file(beside) else None)


def _mask_in(folder: Path, image: Path) -> Path | None:
    """Find the mask of 1.jpg: a picture 1, COLMAP's 1.jpg.png, or Metashape's 1_mask."""
    names = (image.stem, image.name, f"{image.stem}_mask", f"{image.name}_mask")
    return next(filter(None, (_picture(folder / name) for name in names)), None)


def _picture(bare_path: Path) -> Path | None:
    """Return the image file of this path without suffix."""
    found = find_image(bare_path)
    return found if found and bare(found).name != found.name and found.name != bare_path.name else None


def masks_beside(folder: str) -> str:
    """Return masks_2 for images_2: where nerfstudio keeps masks of downscaled photos."""
    return "masks" + folder.removeprefix("images")


def unused_masks(cameras: Iterable[SourceCamera], source: Path) -> list[Path]:
    """Find pictures in mask folders of the source, or next to its photos' folder, that are not used as a mask.

    For photos in images_2, masks_2 is included. Copies of one mask at several sizes are counted once.
    """
    here = [one for one in cameras if one.image]
    folders = {source / "masks": None}
    for parent in dict.fromkeys(one.photo.parent for one in here):
        if parent.name.startswith("images"):
            folders |= {parent.parent / "masks": None, parent.parent / masks_beside(parent.name): None}
    used = {_below(one.mask) for one in here if one.mask}
    found = []
    for folder in folders:
        for place, _, names in os.walk(folder):
            shown = (name for name in names if name[0] != ".")
            pictures = [Path(place, name) for name in shown if Path(name).suffix.lower() in IMAGE_SUFFIXES]
            found += [one for one in pictures if _below(one) not in used]
    return sorted({Path(os.path.normpath(one)): None for one in found}, key=lambda one: natural(str(one)))


def _below(mask: Path) -> Path:
    """Return the path of a mask relative to its mask folder, of any size; the whole path if it is in none."""
    parts = Path(os.path.normpath(mask)).parts
    inside = (place for place in reversed(range(len(parts) - 1)) if parts[place].startswith("masks"))
    return Path(*parts[next(inside, -1) + 1 :])


def images_in(folder: Path) -> list[Path]:
    """List the photos of a folder in natural order, 2 before 10, without masks and hidden files."""
    found = [
        item
        for item in folder.iterdir()
        if item.suffix.lower() in IMAGE_SUFFIXES and item.is_file() and not item.name.startswith(".")
        and not item.stem.endswith("_mask") and not item.name.startswith(_DYNAMIC)
    ]  # fmt: skip
    return sorted(found, key=lambda item: natural(item.name))


def folders_of_photos(folder: Path) -> Iterator[Path]:
    """Yield `folder` and its subfolders, except hidden ones and the artifacts of a work folder."""
    for place, below, files in os.walk(folder):
        below[:] = () if "manifest.json" in files else sorted(name for name in below if name[0] != ".")
        if "manifest.json" not in files:
            yield Path(place)


def natural(text: str) -> tuple:
    """Return a sort key that compares numbers inside names as numbers."""
    parts: list[tuple[int, int, str]] = []
    digits = ""
    for letter in text + "\0":
        if letter.isascii() and letter.isdigit():
            digits += letter
            continue
        if digits:
            value = digits.lstrip("0")  # compared as text: int() rejects thousands of digits
            parts.append((0, len(value), value))
            digits = ""
        parts.append((1, 0, letter))
    return tuple(parts)


def path_in_source(photo: Path, root: Path) -> str:
    """Return the photo's path relative to its source; for a photo elsewhere, its folder's name and its own."""
    return str(photo.relative_to(root) if photo.is_relative_to(root) else Path(photo.parent.name, photo.name))


def image_folder(root: Path, wanted: str) -> Path:
    """Return the folder that --images names, inside the source or elsewhere; BadInput if there is none."""
    for folder in (root / wanted, Path(wanted)):
        if folder.is_dir():
            return folder
    raise BadInput(f"--images {wanted}: folder not found in {root}; name the folder of the photos")
