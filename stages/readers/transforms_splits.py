"""Which frames of a transforms.json train and which test, where it lists them by name as nerfstudio does."""

import unicodedata
from pathlib import PurePosixPath

from schemas.errors import BadInput
from schemas.safe_names import printable

KEYS = {"train_filenames": "train", "val_filenames": "test", "test_filenames": "test"}


class Splits:
    """The lists of one file. of(file_path): train, test, or None where there are no lists; left_out(file_path)."""

    def __init__(self, content: dict, where: str) -> None:
        lists = {key: self._names(content, key, where) for key in KEYS if content.get(key)}
        self._where, self._lists = where, lists
        self._told = {name: "test" for key, names in lists.items() if KEYS[key] == "test" for name in names}
        self._told |= dict.fromkeys(lists.get("train_filenames", ()), "train")

    @staticmethod
    def _names(content: dict, key: str, where: str) -> dict[str, str]:
        names = content[key]
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            shown = printable(f"{names!r:.40}")
            raise BadInput(f"{where}: {key} is {shown}, expected a list of photos; export it again")
        return {_spelled(name): name for name in names}

    def of(self, file_path: str) -> str | None:
        """The split of a frame. Frames outside of lists of tests train, where no list says what trains."""
        return self._told.get(_spelled(file_path), "train") if self._lists else None

    def left_out(self, file_path: str) -> bool:
        """Whether the frame stands in none of the lists, one of which tells what trains."""
        return "train_filenames" in self._lists and _spelled(file_path) not in self._told

    def remarks(self, file_paths: list[str]) -> list[str]:
        """What is odd about the lists, a line each."""
        frames, lines = {_spelled(path) for path in file_paths}, []
        for key, names in self._lists.items():
            if lost := [name for spelled, name in names.items() if spelled not in frames]:
                lines.append(f"{self._where}: {key} names {_few(lost)}, of which there is no frame")
        tests = {name for key, names in self._lists.items() if KEYS[key] == "test" for name in names}
        if both := [name for spelled, name in self._lists.get("train_filenames", {}).items() if spelled in tests]:
            lines.append(f"{self._where}: {_few(both)} to train on and to test: trained on alone")
        if self._lists and "train_filenames" not in self._lists:
            lines.append(f"{self._where} has no train_filenames: all frames that are not kept for tests are trained on")
        return lines


def _spelled(path: str) -> str:
    """One spelling of each path: forward slashes, no ./, accents as one character."""
    return str(PurePosixPath(unicodedata.normalize("NFC", path.replace("\\", "/"))))


def _few(names: list[str]) -> str:
    shown = ", ".join(map(printable, names[:3])) + (", ..." if len(names) > 3 else "")
    return f"{len(names)} photo{'s' * (len(names) > 1)} ({shown})"
