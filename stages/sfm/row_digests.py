"""Which rows of COLMAP's database are whole: the SHA-256 of every row that a finished step left, in a file beside it.

SQLite notices a damaged page, if at all, only where it holds its own structures; a bit flipped in features or matches
passes it and gives other poses.
"""

import hashlib
import json
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

# What is computed row by row, so that a lost row is simply found again.
COMPUTED = ("keypoints", "descriptors", "matches", "two_view_geometries")
_GIVEN = ("rigs", "rig_sensors", "cameras", "frames", "frame_data", "images", "pose_priors")


class Rows:
    """The digests in the file at `journal` of the rows of the database at `path`. Lines cut short are passed over."""

    def __init__(self, path: Path, journal: Path) -> None:
        self._path, self._journal = path, journal
        self._digests: dict[tuple[str, int], str] = {}
        if journal.is_file():
            for line in journal.read_text("utf-8", "replace").splitlines():
                try:
                    table, number, digest = json.loads(line)
                    self._digests[str(table), int(number)] = str(digest)
                except (ValueError, TypeError, RecursionError):
                    continue

    def record(self) -> None:
        """Takes the digests of all rows that have none yet."""
        with closing(self._open()) as database:
            fresh = {row: _digest(database, *row) for row in _rows(database) if row not in self._digests}
        # A line of its own also where an earlier write was cut short.
        text = "\n" + "".join(json.dumps([*row, digest]) + "\n" for row, digest in fresh.items())
        with open(self._journal, "a", encoding="utf-8") as stream:
            stream.write(text)
        self._digests |= fresh

    def sound(self) -> bool:
        """Whether all rows with a digest are as they were. Computed rows without one, of a step cut short, are deleted,
        so that they are computed again."""
        try:
            with closing(self._open()) as database:
                held = set(_rows(database))
                unknown = held - self._digests.keys()
                if not self._digests.keys() <= held or any(table in _GIVEN for table, _ in unknown):
                    return False
                if any(_digest(database, *row) != digest for row, digest in self._digests.items()):
                    return False
                for table, number in unknown:
                    database.execute(f"DELETE FROM {table} WHERE rowid = ?", (number,))
                database.commit()
        except sqlite3.Error:
            return False
        return bool(self._digests)

    def _open(self) -> sqlite3.Connection:
        return sqlite3.connect(f"{self._path.absolute().as_uri()}?mode=rw", uri=True)


def _rows(database: sqlite3.Connection) -> Iterator[tuple[str, int]]:
    for table in (*_GIVEN, *COMPUTED):
        for (number,) in database.execute(f"SELECT rowid FROM {table} ORDER BY rowid").fetchall():
            yield table, number


def _digest(database: sqlite3.Connection, table: str, number: int) -> str:
    found = hashlib.sha256()
    for value in database.execute(f"SELECT * FROM {table} WHERE rowid = ?", (number,)).fetchone():
        part = value if isinstance(value, bytes) else repr(value).encode("utf-8", "surrogatepass")
        found.update(b"%d " % len(part) + part)
    return found.hexdigest()
