"""A folder of photos and nothing else: which files count, and what to say where none does."""

import shlex
from pathlib import Path

from schemas.errors import BadInput
from stages.readers.source import image_folder, images_in, natural

FOLDERS = ("images", "input", "photos")
UNREADABLE = (".heic", ".heif", ".avif", ".cr2", ".cr3", ".nef", ".arw", ".dng", ".raf", ".orf", ".rw2")
FILMS = (".mp4", ".mov", ".avi", ".mkv", ".webm", ".m4v")


def photos_of(source: Path, images: str = "") -> list[Path]:
    """The photos in `source` or its folder images/ (or --images), masks left out; BadInput where there are none."""
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
        raise BadInput(f"{folder} holds only files that cannot be read ({', '.join(foreign)}); {how}")
    films = [name for name in names if Path(name).suffix.lower() in FILMS]
    if films:
        raise _film(folder / films[0])
    raise BadInput(
        f"{source} holds no photos (PNG, JPEG, TIFF, WebP ...), no transforms.json, no COLMAP model (sparse/0) and no "
        "poses_bounds.npy; give a folder that has one of them"
    )


def unreadable_beside(photos: list[Path]) -> list[Path]:
    """Files of formats that cannot be read in the folder of the photos, but those of a photo that is there as well."""
    there = {photo.stem for photo in photos}
    items = photos[0].parent.iterdir()
    found = (one for one in items if one.suffix.lower() in UNREADABLE and one.stem not in there and one.name[0] != ".")
    return sorted(found, key=lambda one: natural(one.name))


def conversion(folder: Path, suffix: str) -> str:
    """What turns the files of a suffix in a folder into photos that can be read."""
    return f"convert them to JPEG or PNG, with ImageMagick: mogrify -format jpg {shlex.quote(str(folder))}/*{suffix}"


def folder_of(source: Path, images: str = "") -> Path:
    """The folder of the photos: --images, else the source where it holds any, else one of FOLDERS in it."""
    if images:
        return image_folder(source, images)
    if images_in(source):
        return source
    return next((source / name for name in FOLDERS if (source / name).is_dir()), source)


def _no_folder(source: Path) -> BadInput:
    if source.suffix.lower() in FILMS:
        return _film(source)
    return BadInput(f"{source} is a file; give the folder of the photos")


def _film(film: Path) -> BadInput:
    command = f"mkdir -p frames && ffmpeg -i {shlex.quote(str(film))} -vf fps=3 frames/%04d.jpg"
    return BadInput(f"{film} is a video; take frames out of it first: {command}")
