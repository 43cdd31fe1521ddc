"""A folder of plain photos: which files are photos, and what to report if there are none."""

import re
import shlex
from pathlib import Path

from schemas.errors import BadInput
from schemas.safe_names import printable
from stages.readers.source import folders_of_photos, image_folder, images_in, natural
from stages.readers.video import clips_of

FOLDERS = ("images", "input", "photos")
_NO_PHOTOS = re.compile(r"masks(_\d+)?$|images_\d+$")  # names of folders
UNREADABLE = (".heic", ".heif", ".avif", ".cr2", ".cr3", ".nef", ".arw", ".dng", ".raf", ".orf", ".rw2")


def photos_of(source: Path, images: str = "") -> list[Path]:
    """List the photos in `source` or its images/ (or --images), without masks; BadInput if there are none."""
    if not source.exists():
        raise BadInput(f"{source} does not exist; give a folder of photos")
    if source.is_file():
        raise _no_folder(source)
    folder = folder_of(source, images)
    if found := images_in(folder):
        return found
    names = [item.name for item in folder.iterdir()]
    foreign = sorted({Path(name).suffix for name in names if Path(name).suffix.lower() in UNREADABLE})
    if foreign:
        how = conversion(folder, foreign[0])
        raise BadInput(f"{folder} contains only files of unsupported formats ({', '.join(foreign)}); {how}")
    if clips := clips_of(folder):
        raise BadInput(f"{folder} contains no photos, only video ({clips[0].name}); import it without --format photos")
    if others := photos_elsewhere(source, folder):
        inner = printable(str(others[0].parent.relative_to(source)))
        raise BadInput(f"{folder} contains no photos, but {others[0].parent} does; give --images {inner}")
    raise BadInput(
        f"{source} contains no photos (PNG, JPEG, TIFF, WebP ...), no video, no transforms.json, no COLMAP model "
        "(sparse/0) and no poses_bounds.npy; give a folder that has one of these"
    )


def unreadable_beside(photos: list[Path]) -> list[Path]:
    """List files of unsupported formats next to the photos, except other versions of these photos."""
    there = {photo.stem for photo in photos}
    items = photos[0].parent.iterdir()
    found = (one for one in items if one.suffix.lower() in UNREADABLE and one.stem not in there and one.name[0] != ".")
    return sorted(found, key=lambda one: natural(one.name))


def conversion(folder: Path, suffix: str) -> str:
    """Return advice for converting the files of a suffix to a supported format."""
    return f"convert them to JPEG or PNG, with ImageMagick: mogrify -format jpg {shlex.quote(str(folder))}/*{suffix}"


def folder_of(source: Path, images: str = "") -> Path:
    """Return the folder of the photos: --images, else that of the most photos among the source and FOLDERS in it."""
    if images:
        return image_folder(source, images)
    inner = [folder for name in FOLDERS if (folder := source / name).is_dir()]
    most = max((source, *inner), key=lambda folder: len(images_in(folder)))
    return most if images_in(most) else next(iter(inner), source)


def photos_elsewhere(source: Path, chosen: Path) -> list[Path]:
    """List the photos in and below `source` that are not in the chosen folder.

    Masks, hidden folders, artifacts and smaller copies (images_2) are ignored.
    """
    found: list[Path] = []
    for folder in folders_of_photos(source):
        if folder != chosen and not any(map(_NO_PHOTOS.match, folder.relative_to(source).parts)):
            found += images_in(folder)
    return found


def _no_folder(source: Path) -> BadInput:
    return BadInput(f"{source} is a file; give the folder of the photos")
