"""Checks of names and paths from untrusted files before anything is opened or written, and text fit for display."""

import os
import re
import unicodedata
from pathlib import Path
from typing import Any

from schemas.errors import ArtifactDamaged, BadInput, StylerfError

LONGEST_NAME = 255  # bytes, what common file systems take
LONGEST_PATH = 1024  # bytes
_HIDDEN = {"Cc", "Cs", "Zl", "Zp"}  # control characters, surrogates, separators of lines and paragraphs
WINDOWS = os.name == "nt"
_DEVICE = re.compile(r"(con|prn|aux|nul|conin\$|conout\$|(com|lpt)[0-9\u00b9\u00b2\u00b3])( *\..*)?", re.IGNORECASE)
_BIDI = set("\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069\ufeff")


def relative_path(text: object, what: str, fault: type[StylerfError] = ArtifactDamaged) -> str:
    """Return `text` if it is a relative path, with forward slashes, that stays inside its folder.

    Symbolic links are not checked here; see schemas.artifact.

    Args:
        what: Names the path in messages.

    Raises:
        fault: The path is absolute, too long for file systems, or holds `.`, `..`, empty parts, control or
            bidirectional characters, or lone surrogates; on Windows also if it names a drive, a device or
            anything else that Windows cannot store.
    """
    if not isinstance(text, str):
        raise fault(f"{what} is {printable(repr(text))[:60]}, expected a path as text")
    shown = repr(printable(text if len(text) <= 80 else text[:80] + "..."))
    if text.startswith("/") or any(part in ("", ".", "..") for part in text.split("/")):
        raise fault(f"{what} is {shown}, which does not stay inside its folder; expected a relative path without '..'")
    if any(_hidden(letter) for letter in text):
        raise fault(f"{what} is {shown}, which contains control characters or invalid Unicode")
    if len(text.encode()) > LONGEST_PATH or any(len(part.encode()) > LONGEST_NAME for part in text.split("/")):
        raise fault(f"{what} is {shown}, {len(text.encode())} bytes long; a name may have at most {LONGEST_NAME}")
    if WINDOWS and (why := next(filter(None, map(refused_by_windows, text.split("/"))), None)):
        raise fault(f"{what} is {shown}, which Windows cannot store: one of its names {why}")
    return text


def refused_by_windows(name: str) -> str | None:
    """Return why Windows cannot store a file of that name, or stores it under another; None if it can."""
    if bad := re.search(r'[<>:"|?*\\]', name):
        return f"contains {bad[0]}"
    if name[-1:] in (".", " "):
        return "ends in a dot or a space"
    return "is a reserved device name" if _DEVICE.fullmatch(name) else None


def file_name(text: object, what: str, fault: type[StylerfError] = ArtifactDamaged) -> str:
    """Return `text` if it is a safe file name: a relative_path of one part."""
    name = relative_path(text, what, fault)
    if "/" in name:
        raise fault(f"{what} is {printable(name)!r}, expected a name without '/'")
    return name


def check_utf8(path: Path | str) -> None:
    """Raise BadInput for a path that is not UTF-8, which codecs and manifests require."""
    if (name := os.fsencode(path).decode("utf-8", "backslashreplace")) != str(path):
        raise BadInput(f"{printable(name)}: its name is not UTF-8; rename it")


def printable(text: str) -> str:
    """Escape control and bidirectional characters, line breaks and lone surrogates, for a terminal or a page."""
    return "".join(_escaped(letter) if _hidden(letter) else letter for letter in text)


def listed(items: list[str], most: int = 6) -> str:
    """Join at most `most` items: "a, b and 3 more"."""
    if len(items) <= most:
        return ", ".join(items)
    return f"{', '.join(items[:most])} and {len(items) - most} more"


def _hidden(letter: str) -> bool:
    return letter in _BIDI or unicodedata.category(letter) in _HIDDEN


def _escaped(letter: str) -> str:
    return letter.encode("unicode_escape").decode("ascii")


def flags(flag: str, value: Any) -> list[str]:
    """Return the words that set an option, such as --steps 30, --no-masks or --layers a b."""
    if isinstance(value, bool):
        return [flag if value else f"--no-{flag[2:]}"]
    return [flag, *map(str, value if isinstance(value, list | tuple) else [value])]
