"""The identity of a source: every file that an import may read."""

import os
from pathlib import Path

from schemas.canonical import digest_of, file_sha256
from schemas.errors import BadInput
from schemas.store import Work
from stages.readers.source import IMAGE_SUFFIXES

HASHED = (".json", ".npy", ".bin", ".txt")


def digest_of_source(source: Path, images: str = "", work: Work | None = None) -> str:
    """SHA-256 over names and sizes, with the content of files that tell poses and the time of change of photos.

    Photos are not read for it: hundreds of megabytes of them would cost more than the import itself. What lies in the
    work folder is left out; where that is the source itself, its artefacts are.
    """
    if not source.exists():
        raise BadInput(f"{source} does not exist; give a folder of photos with poses")
    root = source.parent if source.is_file() else source
    folders = [root]
    if images and Path(images).is_dir() and not (root / images).is_dir():
        folders.append(Path(images))
    ours = {os.path.realpath(one) for one in [work.root, *(made.path for made in work.artefacts())]} if work else set()
    return digest_of([_entry(path, folder) for folder in folders for path in _files(folder, ours)])


def _files(folder: Path, passed_over: set[str]) -> list[Path]:
    """Those that count, links followed; no folder twice, so that links in a circle end."""
    found, been = [], {os.path.realpath(folder), *passed_over}
    for where, folders, names in os.walk(folder, followlinks=True):
        kept = []
        for name in sorted(name for name in folders if not name.startswith(".")):
            place = os.path.realpath(os.path.join(where, name))
            if place not in been:
                been.add(place)
                kept.append(name)
        folders[:] = kept
        found += [Path(where) / name for name in names if Path(name).suffix.lower() in HASHED + IMAGE_SUFFIXES]
    return sorted(found)


def _entry(path: Path, folder: Path) -> list:
    try:
        facts = path.stat()
        told = file_sha256(path) if path.suffix.lower() in HASHED else facts.st_mtime_ns
    except OSError as error:
        raise BadInput(f"{path} cannot be read ({error.strerror}); restore it or its permissions") from error
    return [path.relative_to(folder).as_posix(), facts.st_size, told]
