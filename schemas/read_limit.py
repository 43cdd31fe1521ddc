"""The memory that reading one file may use. Commands set it from --memory and from what is free."""

from collections.abc import Callable
from pathlib import Path

from schemas.errors import OutOfResources

LEAST = 256 << 20  # bytes, always allowed: a photo of 22 megapixels in RGB
_DEFAULT = 4 << 30  # bytes, until set_allowance is called, as when stylerf is used as a library
_find: Callable[[], int] | None = None


def set_allowance(find: Callable[[], int] | None) -> None:
    """Set the limit. find: returns the bytes that may still be allocated, called for each large file; None: default."""
    global _find  # noqa: PLW0603 - memory belongs to the process, so its bound does too
    _find = find


def allowance() -> int:
    """Return the bytes that decoding one file may allocate."""
    return max(LEAST, _DEFAULT if _find is None else _find())


def check_allowance(path: Path, width: int, height: int, takes: int) -> None:
    """Raise OutOfResources if a picture of this size, `takes` bytes when decoded, exceeds the limit."""
    if takes > (most := allowance()):
        raise OutOfResources(
            f"{path} is {width}x{height} pixels, which take {takes / 1e9:.1f} GB of memory; {most / 1e9:.1f} GB may be "
            "used; shrink it or raise --memory"
        )
