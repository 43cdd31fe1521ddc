"""Writing so that a file is either whole or absent, and saying plainly when the disk will not take it.

A file is written beside its place under a hidden name, flushed to the disk, and renamed: a reader, or the next run
after a power cut, sees the old bytes or the new ones and never a mixture.
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

TEMPORARY_SUFFIX = ".tmp"
_NO_SPACE = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_NO_PERMISSION = {errno.EACCES, errno.EPERM, errno.EROFS}
_NO_HANDLES = {errno.EMFILE, errno.ENFILE}
_NO_MEMORY = {errno.ENOMEM}
_NO_FLUSH = {errno.EINVAL, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS}  # this disk cannot, which is no failure


def out_of_resources(error: OSError, path: Path | str) -> OutOfResources | None:
    """The fault in words when the machine refuses (space, permission, handles, memory), None for any other OSError."""
    place = error.filename if isinstance(error.filename, str) else path
    if error.errno in _NO_SPACE:
        return OutOfResources(f"no space left to write {place} ({_free(path)}); free some and run the same command")
    if error.errno in _NO_PERMISSION:
        return OutOfResources(f"no permission for {place}; choose a folder you may write to, or change its mode")
    if error.errno in _NO_HANDLES:
        return OutOfResources(f"too many files are open to write {place}; raise `ulimit -n` and run the same command")
    if error.errno in _NO_MEMORY:
        return OutOfResources(f"out of memory at {place}; free some and run the same command")
    return None


def _free(path: Path | str) -> str:
    folder = Path(path)
    while not folder.is_dir() and folder != folder.parent:
        folder = folder.parent
    try:
        return f"{shutil.disk_usage(folder).free / 1e6:.1f} MB free in {folder}"
    except OSError:
        return f"free space of {folder} unknown"


@contextmanager
def writing(path: Path | str) -> Iterator[None]:
    """Turns a full disk or a missing permission met inside the block into OutOfResources naming the file."""
    try:
        yield
    except OSError as error:
        fault = out_of_resources(error, path)
        if fault is None:
            raise
        raise fault from error


def make_folder(path: Path) -> Path:
    """Creates `path` and its parents where absent; OutOfResources where that cannot be."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        refused = OutOfResources(f"cannot create the folder {path} ({error.strerror}); choose another place")
        raise out_of_resources(error, path) or refused from error
    return path


def sync_folder(path: Path) -> None:
    """Flushes the entries of a folder (its renames) to the disk, where the disk can: some network disks cannot."""
    _sync(path, os.O_RDONLY | os.O_DIRECTORY)


def sync_file(path: Path) -> None:
    """Flushes the bytes of a file to the disk, where the disk can."""
    _sync(path, os.O_RDONLY)


def _sync(path: Path, flags: int) -> None:
    handle = os.open(path, flags | os.O_CLOEXEC)
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in _NO_FLUSH:
            raise
    finally:
        os.close(handle)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Gives a hidden path beside `path` (same extension) to write to; on leaving, flushes and renames it into place.

    When the block raises, the hidden file is deleted and `path` is as it was. The parent folder is created.
    """
    make_folder(path.parent)
    # Codecs choose their format by the extension, so the mark of a temporary file goes before it.
    temporary = path.parent / f".{path.stem[:40]}.{secrets.token_hex(4)}{TEMPORARY_SUFFIX}{path.suffix[:8]}"
    try:
        with writing(path):
            yield temporary
            sync_file(temporary)
            os.replace(temporary, path)
            sync_folder(path.parent)
    finally:
        temporary.unlink(missing_ok=True)


def is_temporary(path: Path) -> bool:
    """Whether `path` is named as the leftover of an interrupted write."""
    return path.name.startswith(".") and TEMPORARY_SUFFIX in (path.suffix, Path(path.stem).suffix)


@contextmanager
def sweeping(folders: Collection[Path]) -> Iterator[None]:
    """On leaving, delete leftovers of interrupted writes that were in these folders on entering.

    Files that another process began to write since are left alone.
    """
    leftovers = [path for folder in folders for path in folder.glob(".*") if is_temporary(path)]
    try:
        yield
    finally:
        for path in leftovers:
            with suppress(OSError):
                path.unlink()


def write_bytes(path: Path, data: bytes) -> None:
    """Replaces the file `path` by `data` as one step."""
    with replacing(path) as temporary:
        with open(temporary, "wb") as stream:
            stream.write(data)


def write_json(path: Path, value: Any) -> None:
    """Replaces the file `path` by `value` as indented JSON (see `schemas.canonical_json.plain`) as one step."""
    text = json.dumps(plain(value), indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    write_bytes(path, text.encode("utf-8", "surrogatepass"))


def refusal_of_disk(path: Path, size: int) -> OutOfResources | None:
    """Why a codec that only says 'failed' could not write about `size` bytes at `path`: tries the same with zeros.

    Returns None when the zeros could be written, so the codec failed for a reason of its own.
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
        told = f"{path} cannot be written ({error.strerror}); run the same command when the disk takes it"
        return out_of_resources(error, path) or OutOfResources(told)
    finally:
        trial.unlink(missing_ok=True)
    return None
