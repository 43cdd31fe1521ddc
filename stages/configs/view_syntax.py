"""Options that name something in a view: a pixel, an image, a range of depths."""

import re
from pathlib import Path

NUMBER = r"\d+(?:\.\d*)?|\.\d+"


def pixel_of(text: str) -> tuple[str, float, float]:
    """Parse '0012:200,140' as ('0012', 200.0, 140.0); ValueError for anything else."""
    match = re.fullmatch(r"(.+):(\d+(?:\.\d+)?),(\d+(?:\.\d+)?)", text)
    if not match:
        raise ValueError(f"{text!r} is not a pixel of a view, written VIEW:X,Y")
    return match[1], float(match[2]), float(match[3])


def file_of(text: str) -> tuple[str, Path]:
    """Parse '0012=head.png' as ('0012', head.png), expanding ~; ValueError for anything else."""
    view, equals, path = text.partition("=")
    if not (view and equals and path):
        raise ValueError(f"{text!r} is not an image of a view, written VIEW=FILE.png")
    return view, Path(path).expanduser()


def depth_of(text: str) -> tuple[str, float, float]:
    """Parse '0012:1.5,2' as ('0012', 1.5, 2.0); ValueError for anything else."""
    match = re.fullmatch(rf"(.+):({NUMBER}),({NUMBER})", text)
    if not match or float(match[2]) >= float(match[3]):
        raise ValueError(f"{text!r} is not a range of depths in a view, written VIEW:NEAR,FAR")
    return match[1], float(match[2]), float(match[3])
