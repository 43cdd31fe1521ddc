"""A folder of plain photos: which files count, and what to report if none does."""

import shlex
from pathlib import Path

from schemas.errors import BadInput
from stages.readers.source import image_folder, images_in, natural
from stages.readers.video import clips_of

FOLDERS = ("images", "input", "photos")
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
        raise BadInput(f"{folder} holds only files of unsupported formats ({', '.join(foreign)}); {how}")
    if clips := clips_of(folder):
        raise BadInput(f"{folder} holds no photos, but video ({clips[0].name}); import it without --format photos")
    raise BadInput(
        f"{source} holds no photos (PNG, JPEG, TIFF, WebP ...), no video, no transforms.json, no COLMAP model "
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
    """Return the folder of the photos: --images, else the source if it holds any, else one of FOLDERS in it."""
    if images:
        return image_folder(source, images)
    if images_in(source):
        return source
    return next((source / name for name in FOLDERS if (source / name).is_dir()), source)


def _no_folder(source: Path) -> BadInput:
    return BadInput(f"{source} is a file; give the folder of the photos")
