"""Finds the photos of a pose list, whose paths may come from another machine, folder or Unicode form."""

import re
import unicodedata
from pathlib import Path

from schemas.errors import BadInput
from schemas.safe_names import printable, relative_path
from stages.readers.source import bare, find_image


def inner_path(listed: str, where: str) -> str:
    """Return the listed path with forward slashes, without root or drive, starting after its last `..`.

    Raises:
        BadInput: It is not a valid path; the message begins with `where`.
    """
    parts = _parts(listed)
    parts = parts[1:] if parts and re.fullmatch("[A-Za-z]:", parts[0]) else parts
    start = max((index + 1 for index, part in enumerate(parts) if part == ".."), default=0)
    return relative_path("/".join(parts[start:]), f"{where}: its photo", BadInput)


def _parts(listed: str) -> list[str]:
    return [part for part in listed.replace("\\", "/").split("/") if part not in ("", ".")]


class Folder:
    """Finds the photos of a list in a folder by their listed paths, then without leading folders, finally by name.

    above: a second folder where whole listed paths are tried. Photos outside these two are never found. Two entries
    with different paths may not share a photo.
    """

    def __init__(self, folder: Path, above: Path | None = None, where: str = "") -> None:
        self.folder, self.above, self.where = folder, above, where
        self.shortened: list[str] = []  # listed paths of photos found without their leading folders
        self._taken: dict[Path, str] = {}

    def photo(self, listed: str) -> tuple[str, Path | None]:
        """Return the name of its view and the file, None if there is none."""
        inner = inner_path(listed, self.where or f"{self.folder}")
        found, root, as_listed = self._found(inner)
        if found is None:
            return bare(Path(inner)).as_posix(), None
        if _parts(other := self._taken.setdefault(found, listed)) != _parts(listed):
            raise BadInput(
                f"{self.where}: {printable(other)} and {printable(listed)} would both be the photo {found}; put the "
                "photos in folders as the list has them"
            )
        if not as_listed or inner != "/".join(_parts(listed)):
            self.shortened.append(listed)
        return bare(found.relative_to(root)).as_posix(), found

    def remarks(self) -> tuple[str, ...]:
        """Return lines for the user about photos that were not at their listed paths."""
        if not self.shortened:
            return ()
        first = printable(self.shortened[0])
        return (f"{len(self.shortened)} photos were found by the end of their listed paths (first: {first})",)

    def _found(self, inner: str) -> tuple[Path | None, Path, bool]:
        """Return the file, the folder it was found in, and whether that was `folder`, by its whole path."""
        parts = inner.split("/")
        places = [(self.folder, "/".join(parts[start:])) for start in range(len(parts))]
        if self.above:
            places.insert(1, (self.above, inner))
        for root, path in places:
            # macOS writes decomposed names, other systems composed ones.
            forms = (path, *(unicodedata.normalize(one, path) for one in ("NFC", "NFD")))
            titled = (str(Path(form).with_suffix(Path(form).suffix.title())) for form in forms)  # .Jpg
            for form in dict.fromkeys((*forms, *titled)):
                if found := find_image(root / form):
                    return found, root, (root, path) == places[0]
        return None, self.folder, False
