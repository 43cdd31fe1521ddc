"""Atomic file writes, with clear errors if the machine refuses.

A file is written under a hidden name in the same folder, flushed to disk, and renamed: readers, and the next run after
a power cut, see the old bytes or the new ones, never a mixture.
"""

import errno
import json
import os
import secrets
import shutil
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from schemas.canonical_json import plain
from schemas.errors import OutOfResources
from schemas.open_flags import DIRECTORY

TEMPORARY_SUFFIX = ".tmp"
_NO_SPACE = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_NO_PERMISSION = {errno.EACCES, errno.EPERM, errno.EROFS}
_NO_HANDLES = {errno.EMFILE, errno.ENFILE}
_NO_MEMORY = {errno.ENOMEM}
_NO_FLUSH = {errno.EINVAL, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS}  # unsupported by some disks, not a failure


def out_of_resources(error: OSError, path: Path | str) -> OutOfResources | None:
    """Translate an OSError for lack of space, permission, file handles or memory; return None for any other."""
    place = error.filename if isinstance(error.filename, str) else path
    if error.errno in _NO_SPACE:
        return OutOfResources(
            f"no space left to write {place} ({_free(path)}); free some space and run the same command"
        )
    if error.errno in _NO_PERMISSION:
        return OutOfResources(f"no permission for {place}; choose a writable folder, or change its permissions")
    if error.errno in _NO_HANDLES:
        return OutOfResources(f"too many open files to write {place}; raise `ulimit -n` and run the same command")
    if error.errno in _NO_MEMORY:
        return OutOfResources(f"out of memory at {place}; free some memory and run the same command")
    return None


def _free(path: Path | str) -> str:
    folder = Path(path)
    while not folder.is_dir() and folder != folder.parent:
        folder = folder.parent
    try:
        return f"{shutil.disk_usage(folder).free / 1e6:.1f} MB free in {folder}"
    except OSError:
        return f"free space in {folder} unknown"


@contextmanager
def writing(path: Path | str) -> Iterator[None]:
    """Turn a full disk or missing permission inside the block into OutOfResources naming the file."""
    try:
        yield
    except OSError as error:
        fault = out_of_resources(error, path)
        if fault is None:
            raise
        raise fault from error


def make_folder(path: Path) -> Path:
    """Create `path` and its parents if missing; OutOfResources if that fails."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        refused = OutOfResources(f"cannot create the folder {path} ({error.strerror}); choose another place")
        raise out_of_resources(error, path) or refused from error
    return path


def sync_folder(path: Path) -> None:
    """Flush the entries of a folder (its renames) to the disk, if disk and system can."""
    if DIRECTORY:
        _sync(path, os.O_RDONLY | DIRECTORY)


def sync_file(path: Path) -> None:
    """Flush the bytes of a file to the disk, if it can."""
    _sync(path, os.O_RDWR if os.name == "nt" else os.O_RDONLY)  # Windows flushes only files that are open for writing


def _sync(path: Path, flags: int) -> None:
    handle = os.open(path, flags)
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in _NO_FLUSH:
            raise
    finally:
        os.close(handle)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a hidden path beside `path`, with the same extension, to write to; then flush it and rename it to `path`.

    Creates the parent folder. If the block raises, deletes the hidden file and leaves `path` unchanged.
    """
    make_folder(path.parent)
    # Codecs pick the format by extension, so the temporary mark goes before it.
    temporary = path.parent / f".{path.stem[:40]}.{secrets.token_hex(4)}{TEMPORARY_SUFFIX}{path.suffix[:8]}"
    try:
        with writing(path):
            yield temporary
            # Bytes first, then the name, then the folder's entry: a rename that reaches the disk before the bytes would
            # leave an empty file after a power cut.
            sync_file(temporary)
            os.replace(temporary, path)
            sync_folder(path.parent)
    finally:
        # After a successful rename nothing remains under this name.
        temporary.unlink(missing_ok=True)


def is_temporary(path: Path) -> bool:
    """Return whether the name of `path` is that of an interrupted write's leftover."""
    return path.name.startswith(".") and TEMPORARY_SUFFIX in (path.suffix, Path(path.stem).suffix)


@contextmanager
def sweeping(folders: Collection[Path]) -> Iterator[None]:
    """On leaving, delete leftovers of interrupted writes that were in these folders on entering.

    Files that another process has begun to write since are not touched.
    """
    leftovers = [path for folder in folders for path in folder.glob(".*") if is_temporary(path)]
    try:
        yield
    finally:
        for path in leftovers:
            with suppress(OSError):
                path.unlink()


def write_bytes(path: Path, data: bytes) -> None:
    """Write `data` to `path` atomically."""
    with replacing(path) as temporary:
        with open(temporary, "wb") as stream:
            stream.write(data)


def write_json(path: Path, value: Any) -> None:
    """Write `value` to `path` atomically, as indented JSON (see schemas.canonical_json.plain)."""
    text = json.dumps(plain(value), indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    write_bytes(path, text.encode("utf-8", "surrogatepass"))


def refusal_of_disk(path: Path, size: int) -> OutOfResources | None:
    """Find out why a codec could not write about `size` bytes at `path`, by writing as many zeros there.

    Returns None if the zeros fit, so that the disk is not to blame.
    """
    trial = path.parent / f".{path.stem[:40]}.{secrets.token_hex(4)}{TEMPORARY_SUFFIX}"
    block = bytes(1 << 20)
    try:
        with open(trial, "wb") as stream:
            for start in range(0, size, len(block)):
                stream.write(block[: size - start])
            stream.flush()
            os.fsync(stream.fileno())
    except OSError as error:
        message = f"{path} cannot be written ({error.strerror}); run the same command when the disk is writable"
        return out_of_resources(error, path) or OutOfResources(message)
    finally:
        trial.unlink(missing_ok=True)
    return None
