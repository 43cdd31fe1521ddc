"""The right of one process to write one artifact, by a lock that the system frees when the process ends.

The lock is on two things: a small file, `.NAME.lock`, that names the process which holds it, and the folder that is
written to, so that a second writer is kept out even where somebody has deleted that file.
"""

import errno
import fcntl
import os
import re
import socket
import stat
from contextlib import suppress
from pathlib import Path

from schemas.atomic_write import make_folder, writing
from schemas.errors import OutOfResources, WouldBeLost

_HELD = {errno.EWOULDBLOCK, errno.EAGAIN, errno.EACCES}
_OWN_TEXT = re.compile(rb"\d{1,20}( [\x21-\x7e]{1,64})?\n?")  # process and host; what else stands there is not ours
_TRIES = 10  # a lock file that is deleted each time it is taken


class Lock:
    """The right to write what `path` stands for. Freed by release() and when the process ends, however it ends."""

    def __init__(self, path: Path, instead: str = "give another --name") -> None:
        """Takes the lock at `path`. instead: what there is to do but wait.

        OutOfResources naming the holder where another process has it, or where the disk knows no locks; WouldBeLost
        where something that is no lock file lies there, a link above all: nothing is written to it.
        """
        self.path, self._instead = path, instead
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
            self.release()  # deleted between opening and locking: whoever comes next would not see our lock
        else:
            raise OutOfResources(f"{path} is deleted again and again; find out by whom, and run the same command")
        with suppress(OSError):  # only so that the other side can name us; a full disk is met soon enough
            os.ftruncate(self._handle, 0)
            os.pwrite(self._handle, f"{os.getpid()} {_host()}\n".encode(), 0)

    def hold_folder(self, folder: Path) -> None:
        """Locks `folder` too, in place of the one held so far; OutOfResources where another process writes there."""
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(handle)
            if error.errno in _HELD - {errno.EACCES}:
                raise self._held_by("unknown") from error
            return  # some disks, NFS among them, lock files alone
        self._close_folder()
        self._folder = handle

    def release(self) -> None:
        """Gives the lock back; harmless when it was given back before."""
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
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno not in _HELD:
                raise OutOfResources(
                    f"{self.path} cannot be locked ({error.strerror}), so nothing keeps two processes apart; choose a "
                    "work folder on a disk that can"
                ) from error
            process, _, host = os.pread(handle, 100, 0).decode("ascii", "replace").strip().partition(" ")
            raise self._held_by(f"{process or 'unknown'} on {host}" if host else process or "unknown") from error

    def _held_by(self, holder: str) -> OutOfResources:
        name = self.path.name.removeprefix(".").removesuffix(".lock")
        return OutOfResources(
            f"{self.path.parent.name} {name} is being written by another process ({holder}); wait for it to end, or "
            f"{self._instead}"
        )


def _opened(path: Path) -> int:
    """A handle of the lock file, made where absent; WouldBeLost where what lies there is no lock file."""
    # Without O_NONBLOCK, a named pipe would wait for its other end.
    flags = os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    with writing(path):
        try:
            handle = os.open(path, flags | os.O_RDWR | os.O_CREAT, 0o666)
        except PermissionError as denied:  # one that a member of the group left: reading is enough to lock it
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
        ours = stat.S_ISREG(found.st_mode) and found.st_nlink <= 1 and found.st_size <= 100
        text = os.pread(handle, 101, 0) if ours else b""
        if not ours or (text and not _OWN_TEXT.fullmatch(text)):
            raise _not_ours(path)
        folder = os.stat(path.parent)
        if found.st_uid == os.geteuid():  # whoever may write to the folder may take its locks
            with suppress(OSError):
                os.fchmod(handle, stat.S_IMODE(folder.st_mode) & 0o666 | 0o600)
        elif not folder.st_mode & 0o022 and os.geteuid() != 0:
            raise _not_ours(path)
    except BaseException:
        os.close(handle)
        raise
    return handle


def _not_ours(path: Path) -> WouldBeLost:
    return WouldBeLost(f"{path} is no lock file of stylerf's (a link, or it holds something else); move it elsewhere")


def _is_still(path: Path, handle: int) -> bool:
    try:
        return os.path.samestat(os.stat(path, follow_symlinks=False), os.fstat(handle))
    except FileNotFoundError:
        return False


def _host() -> str:
    return re.sub(r"[^\x21-\x7e]", "", socket.gethostname())[:64] or "unknown"
