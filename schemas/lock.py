"""Locks that let one process at a time write an artifact; the system releases them when the process ends.

Two things are locked: a small file, `.NAME.lock`, that names the process holding it, and the folder being written to,
so that a second writer is kept out even if somebody deletes that file. (Windows cannot lock folders, but does not
delete open files either.) filelock locks the open file, so that the checks below apply to exactly the file that is
locked.
"""

import errno
import os
import re
import socket
import stat
from contextlib import suppress
from pathlib import Path

from filelock import lock_descriptor

from schemas.atomic_write import make_folder, writing
from schemas.errors import OutOfResources, WouldBeLost
from schemas.open_flags import DIRECTORY, NOFOLLOW, NONBLOCK

# Process and host, after a space: Windows locks the first byte, which others then cannot read.
_OWN_TEXT = re.compile(rb" ?\d{1,20}( [\x21-\x7e]{1,64})?\n?")
_TEXT_START = 1 if os.name == "nt" else 0
_TRIES = 10  # attempts, if the lock file is deleted each time


class Lock:
    """The right to write one artifact. Released by release() and when the process ends, however it ends."""

    def __init__(self, path: Path, instead: str = "give another --name", use: str = "written") -> None:
        """Take the lock.

        Args:
            path: The lock file, created if missing.
            instead: What the user can do other than wait, for the message.
            use: What the holder does, for the message: the artifact is being written, or the folder shown.

        Raises:
            OutOfResources: Another process holds the lock (the message names it), or the disk does not support locks.
            WouldBeLost: Something other than a lock file has this name, such as a link. It is not written to.
        """
        self.path, self._instead, self._use = path, instead, use
        self._folder: int | None = None
        make_folder(path.parent)
        for _ in range(_TRIES):
            self._handle: int | None = _opened(path)
            try:
                self._take(self._handle)
                if _is_still(path, self._handle):
                    break
            except BaseException:
                self.release()
                raise
            self.release()  # deleted between opening and locking: the next process would not see our lock
        else:
            raise OutOfResources(f"{path} keeps being deleted; stop whatever deletes it, and run the same command")
        with suppress(OSError):  # only so that others can name us; a full disk is reported soon enough
            os.ftruncate(self._handle, 0)
            os.lseek(self._handle, 0, os.SEEK_SET)
            os.write(self._handle, f" {os.getpid()} {_host()}\n".encode())

    def hold_folder(self, folder: Path) -> None:
        """Lock `folder` too, instead of the one locked before; OutOfResources if another process writes there."""
        if not DIRECTORY:
            return  # Windows cannot open folders, and does not let the open lock file be deleted
        handle = os.open(folder, os.O_RDONLY | DIRECTORY | NOFOLLOW)
        try:
            free = lock_descriptor(handle, blocking=False)
        except OSError:  # some disks, such as NFS, lock only files
            os.close(handle)
            return
        if not free:
            os.close(handle)
            raise self._held_by("unknown")
        # The new lock first, so that the folders are never both unlocked.
        self._close_folder()
        self._folder = handle

    def descriptors(self) -> tuple[int, ...]:
        """Return the open files that hold the lock. A child that inherits them holds it too, until both have ended."""
        return tuple(one for one in (self._handle, self._folder) if one is not None)

    def release(self) -> None:
        """Release the lock; harmless if already released."""
        self._close_folder()
        if self._handle is not None:
            os.close(self._handle)
            self._handle = None

    def _close_folder(self) -> None:
        if self._folder is not None:
            os.close(self._folder)
            self._folder = None

    def _take(self, handle: int) -> None:
        try:
            free = lock_descriptor(handle, blocking=False)
        except OSError as error:
            raise OutOfResources(
                f"{self.path} cannot be locked ({error.strerror}), so two processes could collide; choose a work "
                "folder on a disk that supports locks"
            ) from error
        if not free:
            process, _, host = _text(handle).decode("ascii", "replace").strip().partition(" ")
            raise self._held_by(f"{process or 'unknown'} on {host}" if host else process or "unknown")

    def _held_by(self, holder: str) -> OutOfResources:
        name = self.path.name.removeprefix(".").removesuffix(".lock")
        what = f"{self.path.parent.name} {name}" if self._use == "written" else str(self.path.parent)
        return OutOfResources(
            f"{what} is being {self._use} by another process ({holder}); wait for it to finish, or {self._instead}"
        )


def _opened(path: Path) -> int:
    """Open the lock file, creating it if missing; WouldBeLost if it is something else."""
    if not NOFOLLOW and path.is_symlink():
        raise _not_ours(path)
    # A link would let us truncate its target; opening a pipe without NONBLOCK would wait for its other end.
    flags = NOFOLLOW | NONBLOCK
    with writing(path):
        try:
            handle = os.open(path, flags | os.O_RDWR | os.O_CREAT, 0o666)
        except PermissionError as denied:  # created by another member of the group: reading is enough to lock it
            if path.is_dir():  # Windows' error for a folder
                raise _not_ours(path) from denied
            try:
                handle = os.open(path, flags | os.O_RDONLY)
            except FileNotFoundError:
                raise denied from None
        except OSError as error:
            if error.errno not in (errno.ELOOP, errno.EISDIR, errno.ENXIO):
                raise
            raise _not_ours(path) from error
    try:
        found = os.fstat(handle)
        # Checked on the open file, which can no longer be exchanged. A second hard link would be written to as well.
        ours = stat.S_ISREG(found.st_mode) and found.st_nlink <= 1 and found.st_size <= 100
        text = _text(handle) if ours else b""
        if not ours or (text and not _OWN_TEXT.fullmatch(text)):
            raise _not_ours(path)
        if hasattr(os, "geteuid"):
            _share(path, handle, found)
    except BaseException:
        os.close(handle)
        raise
    return handle


def _share(path: Path, handle: int, found: os.stat_result) -> None:
    """Let everyone who may write to the folder take its locks; reject lock files of anybody else."""
    folder = os.stat(path.parent)
    if found.st_uid == os.geteuid():
        with suppress(OSError):
            os.fchmod(handle, stat.S_IMODE(folder.st_mode) & 0o666 | 0o600)
    elif not folder.st_mode & 0o022 and os.geteuid() != 0:
        raise _not_ours(path)


def _text(handle: int) -> bytes:
    """Return what the lock file records about its holder."""
    os.lseek(handle, _TEXT_START, os.SEEK_SET)
    return os.read(handle, 101)


def _not_ours(path: Path) -> WouldBeLost:
    return WouldBeLost(f"{path} is not a stylerf lock file (it is a link, or has other contents); move it away")


def _is_still(path: Path, handle: int) -> bool:
    try:
        # Same device and inode: a lock on a deleted file excludes nobody who opens the new one.
        return os.path.samestat(os.stat(path, follow_symlinks=False), os.fstat(handle))
    except FileNotFoundError:
        return False


def _host() -> str:
    return re.sub(r"[^\x21-\x7e]", "", socket.gethostname())[:64] or "unknown"
