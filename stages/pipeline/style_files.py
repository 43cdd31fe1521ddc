"""The style image that an option names."""

import re
from pathlib import Path

from schemas.canonical_json import file_sha256
from schemas.errors import BadInput

LONGEST_NAME = 60  # names of artifacts made with a style image append to its name


def style_file(text: str) -> Path:
    """Return the path of the style image; BadInput if there is no such file."""
    if not Path(text).is_file():
        raise BadInput(f"--style {text}: there is no such image")
    return Path(text)


def name_of(style: Path) -> str:
    """Return the file name of a style image as part of an artifact's name.

    Long names are cut and made unique by the file's digest, which also replaces names without a usable character.
    """
    name = re.sub(r"[^A-Za-z0-9._+-]+", "_", style.stem).strip("._+-")
    if 0 < len(name) <= LONGEST_NAME:
        return name
    return f"{name[: LONGEST_NAME - 7] or 'style'}-{file_sha256(style)[:6]}"
