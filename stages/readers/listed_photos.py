"""Photos as lists of poses name them: by paths of another machine, of another folder, or in another form of Unicode."""

import re
import unicodedata
from pathlib import Path

from schemas.errors import BadInput
from schemas.safe_names import printable, relative_path
from stages.readers.source import bare, find_image


def inner_path(listed: str, where: str) -> str:
    """The listed path with forward slashes, without its root or drive and without all up to its last `..`.

    BadInput, naming `where`, for what cannot be a file's name.
    """
    parts = _parts(listed)
    parts = parts[1:] if parts and re.fullmatch("[A-Za-z]:", parts[0]) else parts
    start = max((index + 1 for index, part in enumerate(parts) if part == ".."), default=0)
    return relative_path("/".join(parts[start:]), f"{where}: its photo", BadInput)


def _parts(listed: str) -> list[str]:
    return [part for part in listed.replace("\\", "/").split("/") if part not in ("", ".")]


class Folder:
    """Finds the photos of a list in a folder, by the listed path, or without its first folders, at last by its name.

    above: where a listed path is looked for as well, as a whole. What is found never lies outside of both. A photo that
    two entries of different paths would take is refused.
    """

    def __init__(self, folder: Path, above: Path | None = None, where: str = "") -> None:
        self.folder, self.above, self.where = folder, above, where
        self.shortened: list[str] = []  # listed paths of photos that were found by the end of their paths
        self._taken: dict[Path, str] = {}

    def photo(self, listed: str) -> tuple[str, Path | None]:
        """The name of its view, and the file: None where there is none."""
        inner = inner_path(listed, self.where or f"{self.folder}")
        found, root, as_listed = self._found(inner)
        if found is None:
            return bare(Path(inner)).as_posix(), None
        if _parts(other := self._taken.setdefault(found, listed)) != _parts(listed):
            raise BadInput(
                f"{self.where}: {printable(other)} and {printable(listed)} would both be the photo {found}; lay photos "
                "into folders as the list has them"
            )
        if not as_listed or inner != "/".join(_parts(listed)):
            self.shortened.append(listed)
        return bare(found.relative_to(root)).as_posix(), found

    def remarks(self) -> tuple[str, ...]:
        """What to say of photos that do not lie where the list has them."""
        if not self.shortened:
            return ()
        first = printable(self.shortened[0])
        return (f"{len(self.shortened)} photos were found by the end of their listed paths ({first} first)",)

    def _found(self, inner: str) -> tuple[Path | None, Path, bool]:
        """The file, the folder that it was looked for in, and whether it lies in `folder` by its whole path."""
        parts = inner.split("/")
        places = [(self.folder, "/".join(parts[start:])) for start in range(len(parts))]
        if self.above:
            places.insert(1, (self.above, inner))
        for root, path in places:
            # macOS writes names decomposed, other systems composed.
            forms = (path, *(unicodedata.normalize(one, path) for one in ("NFC", "NFD")))
            titled = (str(Path(form).with_suffix(Path(form).suffix.title())) for form in forms)  # .Jpg
            for form in dict.fromkeys((*forms, *titled)):
                if found := find_image(root / form):
                    return found, root, (root, path) == places[0]
        return None, self.folder, False
