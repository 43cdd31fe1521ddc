"""What every reader of poses returns: cameras as the source tells them, in our axes but in the source's own frame."""

import math
import os
import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from schemas.errors import BadInput
from stylerf.geometry.distortion import Distortion


@dataclass(frozen=True, eq=False)
class SourceCamera:
    """One photo and its camera.

    image: the file, or None where the source names none that exists; `source` is then the path that was looked for.
    size: (width, height) that the intrinsics are of; None: that of the photo. intrinsics: fx, fy, cx, cy in pixels; a
    focal length of NaN follows from its angle or else from the other one, a principal point of NaN is the center.
    angles: horizontal and vertical field of view in radians, NaN where not told.
    mask: keeps what is white; hides: another picture, that hides what is not black.
    world_from_camera: [4, 4], OpenCV axes, source units. split: train, test or None (not told).
    near_far: planar depths between which this camera sees anything, source units.
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


@dataclass(frozen=True, eq=False)
class SourcePoints:
    """Sparse points in the source's frame: xyz [n, 3] float64, rgb [n, 3] uint8, error [n] float32 pixels."""

    xyz: np.ndarray
    rgb: np.ndarray
    error: np.ndarray


@dataclass(frozen=True, eq=False)
class SourceScene:
    """Everything a source tells. kind: in words. files: those that tell the poses, where a reader names them.
    keeps_frame: the frame is that of a made scene, worth keeping.

    rescalable: photos may be a smaller copy of those that the intrinsics are of. upright: cameras are of the photos as
    EXIF turns them, else as they are stored. sfm: figures of a reconstruction. skipped: (photo, reason) of those that
    the reader left out itself. remarks: what the source tells and the reader passed over or took in one of two ways, a
    line each.
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
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp", ".bmp", ".jp2", ".exr")


def bare(path: Path) -> Path:
    """The path without its suffix where that is an image's: frame.0001 keeps its number."""
    return path.with_suffix("") if path.suffix.lower() in IMAGE_SUFFIXES else path


def find_image(path: Path) -> Path | None:
    """The file at `path`, or, where the source leaves the suffix out, has another case or spells accents as one or two
    characters, the image of that name."""
    spelled = dict.fromkeys([path, *(Path(unicodedata.normalize(form, str(path))) for form in ("NFC", "NFD"))])
    return next(filter(None, map(_spelled_so, spelled)), None)


def _spelled_so(path: Path) -> Path | None:
    if path.suffix.lower() in IMAGE_SUFFIXES:
        for suffix in (path.suffix, path.suffix.lower(), path.suffix.upper()):
            if (candidate := path.with_suffix(suffix)).is_file():
                return candidate
    for suffix in IMAGE_SUFFIXES:
        for candidate in (Path(f"{path}{suffix}"), Path(f"{path}{suffix.upper()}")):
            if candidate.is_file():
                return candidate
    return path if path.is_file() else None


def with_masks(cameras: list[SourceCamera], root: Path) -> list[SourceCamera]:
    """The cameras, those of which the source tells no mask with the one that lies in root/masks or beside the photo;
    all with instant-ngp's dynamic_mask_NAME.png beside the photo.

    BadInput where a mask could be of either of two photos.
    """
    found, photos = [], {}
    for one in cameras:
        if one.image:
            hides = one.image.parent / f"{_DYNAMIC}{one.image.stem}.png"
            one = replace(one, hides=hides) if hides.is_file() else one
        if one.image and not one.mask and (mask := _mask_of(one.image, root)):
            other = photos.setdefault(mask, one.image)
            if os.path.normpath(other.parent) != os.path.normpath(one.image.parent):
                raise BadInput(
                    f"{mask} could be the mask of {other} or of {one.image}; lay masks into folders named as those of "
                    "the photos"
                )
            one = replace(one, mask=mask)
        found.append(one)
    return found


def _mask_of(image: Path, root: Path) -> Path | None:
    """The mask of images_2/a/1.jpg in masks_2/a, masks/images_2/a, masks/a or masks, else a/1_mask.png."""
    above = [part for part in Path(os.path.relpath(image.parent, root)).parts if part != ".."]
    folders = [root.joinpath("masks", *above[start:]) for start in range(len(above) + 1)]
    for place, part in enumerate(above):
        if part.startswith("images_"):
            folders.insert(0, root.joinpath(masks_beside(part), *above[place + 1 :]))
    beside = image.parent / f"{image.stem}_mask.png"
    there = (_mask_in(folder, image) for folder in folders if folder.is_dir())
    return next(filter(None, there), beside if beside.is_file() else None)


def _mask_in(folder: Path, image: Path) -> Path | None:
    """Of 1.jpg the picture 1, COLMAP's 1.jpg.png, or 1_mask as Metashape calls it."""
    names = (image.stem, image.name, f"{image.stem}_mask", f"{image.name}_mask")
    return next(filter(None, (_picture(folder / name) for name in names)), None)


def _picture(bare_path: Path) -> Path | None:
    """The image file whose path without its suffix this is."""
    found = find_image(bare_path)
    return found if found and bare(found).name != found.name and found.name != bare_path.name else None


def masks_beside(folder: str) -> str:
    """masks_2 of images_2: where nerfstudio keeps masks of smaller photos."""
    return "masks" + folder.removeprefix("images")


def unused_masks(cameras: Iterable[SourceCamera], source: Path) -> list[Path]:
    """Pictures in folders called masks, beside the source or the folder of its photos, that are the mask of no camera.

    Where photos are of images_2, masks_2 counts too; where masks/a.png is used, masks_2/a.png is not unused, nor the
    other way round.
    """
    here = [one for one in cameras if one.image]
    folders = {source / "masks": None}
    for parent in dict.fromkeys(one.image.parent for one in here):
        if parent.name.startswith("images"):
            folders |= {parent.parent / "masks": None, parent.parent / masks_beside(parent.name): None}
    used = {_below(one.mask) for one in here if one.mask}
    found = []
    for folder in folders:
        for place, _, names in os.walk(folder):
            pictures = [Path(place, name) for name in names if Path(name).suffix.lower() in IMAGE_SUFFIXES]
            found += [one for one in pictures if _below(one) not in used]
    return sorted({Path(os.path.normpath(one)): None for one in found}, key=lambda one: natural(str(one)))


def _below(mask: Path) -> Path:
    """The path of a mask inside its folder of masks, of whatever size; that itself where it lies in none."""
    parts = Path(os.path.normpath(mask)).parts
    inside = (place for place in reversed(range(len(parts) - 1)) if parts[place].startswith("masks"))
    return Path(*parts[next(inside, -1) + 1 :])


def images_in(folder: Path) -> list[Path]:
    """Photos of a folder in the order that people count: 2 before 10. Masks and hidden files are left out."""
    found = [
        item
        for item in folder.iterdir()
        if item.suffix.lower() in IMAGE_SUFFIXES and item.is_file() and not item.name.startswith(".")
        and not item.stem.endswith("_mask") and not item.name.startswith(_DYNAMIC)
    ]  # fmt: skip
    return sorted(found, key=lambda item: natural(item.name))


def natural(text: str) -> tuple:
    """Sort key by which numbers inside names count as numbers."""
    parts, digits = [], ""
    for letter in text + "\0":
        if letter.isascii() and letter.isdigit():
            digits += letter
            continue
        if digits:
            parts.append((0, int(digits), ""))
            digits = ""
        parts.append((1, 0, letter))
    return tuple(parts)


def told(photo: Path, root: Path) -> str:
    """The photo's path as its source has it; of a photo elsewhere, its folder's name and its own."""
    return str(photo.relative_to(root) if photo.is_relative_to(root) else Path(photo.parent.name, photo.name))


def image_folder(root: Path, wanted: str) -> Path:
    """The folder that --images names, inside the source or anywhere; BadInput where there is none."""
    for folder in (root / wanted, Path(wanted)):
        if folder.is_dir():
            return folder
    raise BadInput(f"--images {wanted}: there is no such folder in {root}; name one that holds the photos")
