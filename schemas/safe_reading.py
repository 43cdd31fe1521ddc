"""Reads untrusted files: regular files only, up to a size limit, within the memory limit (--memory)."""

import json
import os
import stat
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from schemas.atomic_write import out_of_resources
from schemas.errors import ArtifactDamaged, BadInput, OutOfResources, StylerfError
from schemas.open_flags import NONBLOCK
from schemas.safe_names import printable

MIN_ALLOWANCE = 256 << 20  # bytes, always allowed: a photo of 22 megapixels in RGB
_DEFAULT = 4 << 30  # bytes, until set_allowance is called, as when stylerf is used as a library
_find: Callable[[], int] | None = None


def set_allowance(find: Callable[[], int] | None) -> None:
    """Set the limit. find: returns the bytes that may still be allocated, called for each large file; None: default."""
    global _find  # noqa: PLW0603 - memory belongs to the process, so its bound does too
    _find = find


def allowance() -> int:
    """Return the bytes that decoding one file may allocate."""
    return max(MIN_ALLOWANCE, _DEFAULT if _find is None else _find())


def check_allowance(path: Path, width: int, height: int, takes: int) -> None:
    """Raise OutOfResources if a picture of this size, `takes` bytes when decoded, exceeds the limit."""
    if takes > (most := allowance()):
        raise OutOfResources(
            f"{path} is {width}x{height} pixels, which take {takes / 1e9:.1f} GB of memory; the limit is "
            f"{most / 1e9:.1f} GB; shrink it or raise --memory"
        )


MOST_JSON = 256 << 20  # bytes; a scene of 10,000 views takes 8 MB
DEEPEST = 100  # levels of objects and lists
_MORE = 1 << 20  # bytes read at once of a file that grows, or whose file system reports no size (/proc)


@contextmanager
def opened(path: Path | str, fault: type[StylerfError] = BadInput) -> Iterator[BinaryIO]:
    """Open the regular file at `path`, or at the end of a link, for reading.

    Raises:
        fault: It is a named pipe, device or folder, or cannot be read, now or inside the block.
        FileNotFoundError: It does not exist.
        OutOfResources: Permission, file handles or memory are lacking.
    """
    shown = printable(str(path))
    try:
        stream = open(path, "rb", opener=lambda name, flags: os.open(name, flags | NONBLOCK))
    except IsADirectoryError:
        raise fault(f"{shown} is a folder, not a file") from None
    except FileNotFoundError:
        raise
    except ValueError as error:  # a null byte or a lone surrogate in the path
        raise fault(f"{shown} cannot be read: {error}") from error
    except OSError as error:
        raise out_of_resources(error, path) or fault(f"{shown} cannot be read: {error.strerror}") from error
    with stream:
        mode = os.fstat(stream.fileno()).st_mode
        if not stat.S_ISREG(mode):
            raise fault(f"{shown} is {_kind(mode)}, not a file")
        try:
            yield stream
        except OSError as error:
            if isinstance(error, FileNotFoundError):
                raise
            raise out_of_resources(error, path) or fault(f"{shown} cannot be read: {error.strerror}") from error


def read_bytes(path: Path | str, limit: int, fault: type[StylerfError] = BadInput) -> bytes:
    """Read the regular file at `path`; `fault` if it has more than `limit` bytes. Other errors as in opened."""
    shown = printable(str(path))
    with opened(path, fault) as stream:
        if (size := os.fstat(stream.fileno()).st_size) > limit:
            raise fault(f"{shown} has {size / 1e6:.0f} MB; at most {limit / 1e6:.0f} MB can be read")
        data = stream.read(size + 1)  # not limit + 1, which Python would allocate at once
        while size < len(data) <= limit and (more := stream.read(min(_MORE, limit + 1 - len(data)))):
            data += more
    if len(data) > limit:
        raise fault(f"{shown} grew beyond {limit / 1e6:.0f} MB while being read")
    return data


def read_text(path: Path | str, limit: int, fault: type[StylerfError] = BadInput) -> str:
    """Read UTF-8 text, without its byte order mark; `fault` if it is not UTF-8. Other errors as in read_bytes."""
    try:
        return read_bytes(path, limit, fault).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise fault(f"{printable(str(path))} is not UTF-8 text (byte {error.start})") from error


def read_json(path: Path | str, fault: type[StylerfError] = BadInput, limit: int = MOST_JSON) -> Any:
    """Read a JSON document; `fault` if it is invalid or nested too deeply. Other errors as in read_bytes."""
    return parsed(read_text(path, limit, fault), printable(str(path)), fault)


def parsed(text: str, where: str, fault: type[StylerfError] = BadInput) -> Any:
    """Parse JSON; `fault` names `where` it came from, and the line, if it is invalid."""
    too_deep = fault(f"{where} is nested too deeply to be read")
    try:
        value = json.loads(text)
    except RecursionError:
        raise too_deep from None
    except ValueError as error:  # invalid JSON, or an integer with thousands of digits
        raise fault(f"{where} is not valid JSON ({error})") from error
    # json accepts thousands of levels, which other code that descends a value could not handle.
    level = [value]
    for _ in range(DEEPEST):
        level = [one for parent in level if isinstance(parent, dict | list) for one in _children(parent)]
        if not level:
            return value
    raise too_deep


def _children(parent: dict[str, Any] | list[Any]) -> Iterable[Any]:
    return parent.values() if isinstance(parent, dict) else parent


def _kind(mode: int) -> str:
    kinds = {stat.S_IFIFO: "a named pipe", stat.S_IFDIR: "a folder", stat.S_IFSOCK: "a socket"}
    return kinds.get(stat.S_IFMT(mode), "a device")


# What a constructor raises for invalid arguments; InvalidValue is a ValueError.
UNSOUND = (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError, RecursionError)


@contextmanager
def sound(path: Path, what: str) -> Iterator[None]:
    """Raise ArtifactDamaged, naming the path, if code in the block rejects a file's values.

    what: the expected content, with its article.
    """
    try:
        yield
    except UNSOUND as error:
        why = f"missing {error}" if isinstance(error, KeyError) else str(error)
        raise ArtifactDamaged(f"{path} does not hold {what} ({why}); rebuild it") from error
