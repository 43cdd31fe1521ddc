"""Lists of names that tell which photos of a COLMAP model are for tests: of 3DGS (test.txt) and nerfstudio."""

from dataclasses import replace
from pathlib import Path

from schemas.safe_names import printable
from schemas.safe_reading import read_text
from stages.readers.source import SourceCamera

MOST_BYTES = 64 << 20
# In the folder of the photos' folder, or the model's: the first pair of which one is there counts.
OF_ROOT = (("train_list.txt", "train"), ("test_list.txt", "test"), ("validation_list.txt", "test"))
OF_MODEL = (("train.txt", "train"), ("test.txt", "test"))


def lists_of(root: Path, model: Path) -> list[tuple[Path, str]]:
    """The lists that count, with the split of each."""
    for folder, names in ((root, OF_ROOT), (model, OF_MODEL)):
        if found := [(folder / name, split) for name, split in names if (folder / name).is_file()]:
            return found
    return []


def with_splits(
    cameras: list[SourceCamera], lists: list[tuple[Path, str]]
) -> tuple[list[SourceCamera], list[tuple[str, str]], list[str]]:
    """The cameras with the splits that the lists tell; photos that none lists, with the reason; what to say.

    A photo that no list names is of the other split where there are lists of one only, else it is left out. A list that
    names no photo of the model is another file, and does not count.
    """
    told: dict[str, str] = {}
    remarks = []
    known = _keys(cameras)
    for path, split in lists:
        names = [line.strip().replace("\\", "/") for line in read_text(path, MOST_BYTES).splitlines()]
        names = [name for name in names if name and not name.startswith("#")]
        photos = {name: _photo(name, known) for name in names}
        found = set(filter(None, photos.values()))
        if not found:
            remarks.append(f"{path} names no photo of the model and is not used")
        elif unknown := [name for name, photo in photos.items() if not photo]:
            first = printable(unknown[0])
            remarks.append(f"{path}: {len(unknown)} names are of no photo of the model, {first!r} first")
        told = {source: split for source in found} | told
    splits = set(told.values())
    if not splits:
        return cameras, [], remarks
    rest = None if len(splits) == 2 else ({"train", "test"} - splits).pop()
    kept = [replace(one, split=told.get(one.source, rest)) for one in cameras]
    skipped = [(one.source, "in no list of training or test photos") for one in kept if one.split is None]
    train, test = (sum(one.split == split for one in kept) for split in ("train", "test"))
    names = ", ".join(path.name for path, _ in lists)
    remarks.append(f"split by {names}: {train} photos to train on, {test} for tests, {len(skipped)} left out")
    return [one for one in kept if one.split], skipped, remarks


def _keys(cameras: list[SourceCamera]) -> dict[str, str]:
    """The photos by their listed paths, by those without first folders, by the names of their views: what is unique."""
    found: dict[str, set[str]] = {}
    for one in cameras:
        listed = one.source.replace("\\", "/")
        for key in {listed, listed.rsplit("/", 1)[-1], one.name}:
            found.setdefault(key, set()).add(one.source)
    return {key: next(iter(photos)) for key, photos in found.items() if len(photos) == 1}


def _photo(name: str, known: dict[str, str]) -> str | None:
    """The photo that a line means: by its path, or without first folders of it."""
    parts = name.split("/")
    return next((known[end] for start in range(len(parts)) if (end := "/".join(parts[start:])) in known), None)
