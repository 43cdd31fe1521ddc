"""How much memory reading one file may take. The command that runs sets it from --memory and from what is free."""

from collections.abc import Callable
from pathlib import Path

from schemas.errors import OutOfResources

LEAST = 256 << 20  # bytes that one file may always take: a photo of 22 megapixels in RGB
_DEFAULT = 4 << 30  # where nobody has set a bound, as in a program of the user's own
_find: Callable[[], int] | None = None


def set_allowance(find: Callable[[], int] | None) -> None:
    """find: gives the bytes that this process may still take, asked before each large file; None: the default."""
    global _find  # noqa: PLW0603 - memory belongs to the process, so its bound does too
    _find = find


def allowance() -> int:
    """Bytes that decoding one file may take."""
    return max(LEAST, _DEFAULT if _find is None else _find())


def check_allowance(path: Path, width: int, height: int, takes: int) -> None:
    """OutOfResources where a picture of that size, `takes` bytes once decoded, is more than may be taken."""
    if takes > (most := allowance()):
        raise OutOfResources(
            f"{path} is {width}x{height} pixels, which take {takes / 1e9:.1f} GB in memory where {most / 1e9:.1f} GB "
            "may be used; shrink it or raise --memory"
        )
