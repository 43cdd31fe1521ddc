"""A journal of the completed files of an unfinished run: one appended line each, with its SHA-256."""

import json
import os
from collections.abc import Iterable
from pathlib import Path

from schemas.atomic_write import make_folder
from schemas.canonical_json import file_sha256
from schemas.open_flags import NOFOLLOW


class Journal:
    """The journal at `path` of files below `root`. Ignores a last line truncated by a kill."""

    def __init__(self, path: Path, root: Path) -> None:
        self._path, self._root = path, root
        self._digests: dict[str, str] = {}
        self._cut_short = False
        make_folder(path.parent)
        if path.is_file():
            text = path.read_text("utf-8", "replace")
            self._cut_short = bool(text) and not text.endswith("\n")
            for line in text.splitlines():
                self._read(line)

    def _read(self, line: str) -> None:
        try:
            name, digest = json.loads(line)
            self._digests[str(name)] = str(digest)
        except (ValueError, TypeError, RecursionError):
            return

    def add(self, names: Iterable[str]) -> None:
        """Record files, by paths below the root, as they are now; they must be flushed to disk already."""
        fresh = {name: file_sha256(self._root / name) for name in names}
        text = "".join(json.dumps(pair) + "\n" for pair in fresh.items())
        # Not flushed: what a power cut removes from the journal is simply recomputed.
        handle = os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | NOFOLLOW, 0o666)
        with open(handle, "w", encoding="utf-8") as stream:
            stream.write("\n" + text if self._cut_short else text)  # or the first entry would end the fragment's line
        self._cut_short = False
        # After the write: a file that is not in the journal must not be treated as recorded.
        self._digests |= fresh

    def holds(self, names: Iterable[str]) -> bool:
        """Return whether all these files are recorded and unchanged; OSError if one cannot be read."""
        return all(name in self._digests and self._unchanged(name) for name in names)

    def _unchanged(self, name: str) -> bool:
        try:
            return file_sha256(self._root / name) == self._digests[name]
        except (FileNotFoundError, NotADirectoryError):
            return False
