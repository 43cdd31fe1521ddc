"""Train and test frames of a transforms.json that lists them by name, as nerfstudio does."""

import unicodedata
from pathlib import PurePosixPath

from schemas.errors import BadInput
from schemas.safe_names import printable

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
        """Return what is odd about the lists, a line each."""
        frames, lines = {_spelled(path) for path in file_paths}, []
        for key, names in self._lists.items():
            if lost := [name for spelled, name in names.items() if spelled not in frames]:
                lines.append(f"{self._where}: {key} names {_few(lost)}, for which there is no frame")
        tests = {name for key, names in self._lists.items() if KEYS[key] == "test" for name in names}
        if both := [name for spelled, name in self._lists.get("train_filenames", {}).items() if spelled in tests]:
            lines.append(f"{self._where}: {_few(both)} in both train and test lists: used for training only")
        if self._lists and "train_filenames" not in self._lists:
            lines.append(f"{self._where} has no train_filenames: all frames but the test frames are trained on")
        return lines


def _spelled(path: str) -> str:
    """Normalize a path: forward slashes, no ./, composed accents."""
    return str(PurePosixPath(unicodedata.normalize("NFC", path.replace("\\", "/"))))


def _few(names: list[str]) -> str:
    shown = ", ".join(map(printable, names[:3])) + (", ..." if len(names) > 3 else "")
    return f"{len(names)} photo{'s' * (len(names) > 1)} ({shown})"
