"""Which photos are for training and which for tests: lists next to a COLMAP model, keys of a transforms.json."""

import unicodedata
from dataclasses import replace
from pathlib import Path, PurePosixPath

from schemas.errors import BadInput
from schemas.safe_names import printable
from schemas.safe_reading import read_text
from stages.readers.source import SourceCamera

MOST_BYTES = 64 << 20
# In the parent of the photos' folder, or of the model: the first set with any list is used.
OF_ROOT = (("train_list.txt", "train"), ("test_list.txt", "test"), ("validation_list.txt", "test"))
OF_MODEL = (("train.txt", "train"), ("test.txt", "test"))


def lists_of(root: Path, model: Path) -> list[tuple[Path, str]]:
    """Return the lists to use, with the split of each."""
    for folder, names in ((root, OF_ROOT), (model, OF_MODEL)):
        if found := [(folder / name, split) for name, split in names if (folder / name).is_file()]:
            return found
    return []


def with_splits(
    cameras: list[SourceCamera], lists: list[tuple[Path, str]]
) -> tuple[list[SourceCamera], list[tuple[str, str]], list[str]]:
    """Apply split lists; return the cameras, photos in no list with the reason, and lines for the user.

    If all lists are of one split, photos in none belong to the other; otherwise they are left out. A list that names
    no photo of the model is some other file and is ignored.
    """
    splits_of: dict[str, str] = {}
    remarks = []
    known = _keys(cameras)
    for path, split in lists:
        names = [line.strip().replace("\\", "/") for line in read_text(path, MOST_BYTES).splitlines()]
        names = [name for name in names if name and not name.startswith("#")]
        photos = {name: _photo(name, known) for name in names}
        found = set(filter(None, photos.values()))
        if not found:
            remarks.append(f"{path} names no photo of the model and is ignored")
        elif unknown := [name for name, photo in photos.items() if not photo]:
            first = printable(unknown[0])
            remarks.append(f"{path}: {len(unknown)} names match no photo of the model (first: {first!r})")
        splits_of = {source: split for source in found} | splits_of
    splits = set(splits_of.values())
    if not splits:
        return cameras, [], remarks
    rest = None if len(splits) == 2 else ({"train", "test"} - splits).pop()
    kept = [replace(one, split=splits_of.get(one.source, rest)) for one in cameras]
    skipped = [(one.source, "in no train or test list") for one in kept if one.split is None]
    train, test = (sum(one.split == split for one in kept) for split in ("train", "test"))
    read = ", ".join(path.name for path, _ in lists)
    remarks.append(f"split by {read}: {train} train, {test} test, {len(skipped)} left out")
    return [one for one in kept if one.split], skipped, remarks


def _keys(cameras: list[SourceCamera]) -> dict[str, str]:
    """Map listed paths, file names and view names to photos, if unique."""
    found: dict[str, set[str]] = {}
    for one in cameras:
        listed = one.source.replace("\\", "/")
        for key in {listed, listed.rsplit("/", 1)[-1], one.name}:
            found.setdefault(key, set()).add(one.source)
    return {key: next(iter(photos)) for key, photos in found.items() if len(photos) == 1}


def _photo(name: str, known: dict[str, str]) -> str | None:
    """Find the photo of a line by its path, or by the end of its path."""
    parts = name.split("/")
    return next((known[end] for start in range(len(parts)) if (end := "/".join(parts[start:])) in known), None)


KEYS = {"train_filenames": "train", "val_filenames": "test", "test_filenames": "test"}


class Splits:
    """The split lists of one file."""

    def __init__(self, content: dict, where: str) -> None:
        lists = {key: self._names(content, key, where) for key in KEYS if content.get(key)}
        self._where, self._lists = where, lists
        self._splits = {name: "test" for key, names in lists.items() if KEYS[key] == "test" for name in names}
        self._splits |= dict.fromkeys(lists.get("train_filenames", ()), "train")

    @staticmethod
    def _names(content: dict, key: str, where: str) -> dict[str, str]:
        names = content[key]
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            shown = printable(f"{names!r:.40}")
            raise BadInput(f"{where}: {key} is {shown}, expected a list of photos; export it again")
        return {_spelled(name): name for name in names}

    def of(self, file_path: str) -> str | None:
        """Return the split of a frame, None without lists. With test lists only, all other frames train."""
        return self._splits.get(_spelled(file_path), "train") if self._lists else None

    def left_out(self, file_path: str) -> bool:
        """Return whether the frame is in no list although there is a train list."""
        return "train_filenames" in self._lists and _spelled(file_path) not in self._splits

    def remarks(self, file_paths: list[str]) -> list[str]:
        """Return what is unusual about the lists, one line each."""
        frames, lines = {_spelled(path) for path in file_paths}, []
        for key, names in self._lists.items():
            if lost := [name for spelled, name in names.items() if spelled not in frames]:
                lines.append(f"{self._where}: {key} names {_few(lost)} without a frame")
        tests = {name for key, names in self._lists.items() if KEYS[key] == "test" for name in names}
        if both := [name for spelled, name in self._lists.get("train_filenames", {}).items() if spelled in tests]:
            lines.append(f"{self._where}: {_few(both)} in both train and test lists: used for training only")
        if self._lists and "train_filenames" not in self._lists:
            lines.append(f"{self._where} has no train_filenames: training on all frames except the test frames")
        return lines


def _spelled(path: str) -> str:
    """Normalize a path: forward slashes, no ./, composed accents."""
    return str(PurePosixPath(unicodedata.normalize("NFC", path.replace("\\", "/"))))


def _few(names: list[str]) -> str:
    shown = ", ".join(map(printable, names[:3])) + (", ..." if len(names) > 3 else "")
    return f"{len(names)} photo{'s' * (len(names) > 1)} ({shown})"
