"""Guards against files that other users could have written: compiled code, and configuration in the current folder."""

import os
import stat
from collections.abc import Iterator
from contextlib import chdir, contextmanager
from pathlib import Path


def user_id() -> int:
    """Return the user ID; zero on Windows, which has none."""
    return os.geteuid() if hasattr(os, "geteuid") else 0


def not_ours(path: Path) -> str | None:
    """Return why an existing path may have been written by another user, phrased to follow its name; None if not.

    Everything in it must belong to this user, must not be a link, and must not be writable by other users. Its parent
    folders must belong to this user or root, and must not be writable by others unless they are sticky. On Windows,
    whose file modes show neither users nor permissions, only links are checked.
    """
    found = path.lstat()
    if why := _foreign(found) or _open(found):
        return why
    for place in path.rglob("*") if path.is_dir() else ():
        try:
            inside = place.lstat()
        except FileNotFoundError:  # another process has just renamed it into place
            continue
        if why := _foreign(inside) or (_open(inside) if found.st_mode & 0o011 else None):
            return f"holds {place.relative_to(path)}, which {why}"
    # Both the path as given, whose links could be redirected, and the path with links resolved.
    for parent in dict.fromkeys([*Path(os.path.abspath(path)).parents, *path.resolve().parents]):
        for folder in (parent.lstat(), parent.stat()):
            if folder.st_uid not in (0, user_id()):
                return f"is in {parent}, which belongs to user {folder.st_uid}"
        if not folder.st_mode & stat.S_ISVTX and (why := _open(folder)):
            return f"is in {parent}, which {why}"
    return None


def _foreign(found: os.stat_result) -> str | None:
    if stat.S_ISLNK(found.st_mode):
        return "is a link"
    return None if found.st_uid == user_id() else f"belongs to user {found.st_uid}"


def _open(found: os.stat_result) -> str | None:
    if not hasattr(os, "getegid"):
        return None
    # Many systems give each user a private group with the same ID, which may write to all of the user's files.
    own_group = found.st_gid == os.getegid() == user_id()
    others = stat.S_IWOTH if own_group else stat.S_IWOTH | stat.S_IWGRP
    return "can be written by others" if found.st_mode & others else None


@contextmanager
def current_folder(folder: Path) -> Iterator[None]:
    """Make `folder` the current folder inside the block, since libraries read configuration from it when imported.

    Affects all threads, so use it only for imports.

    The previous folder is kept open rather than remembered by name, since it may be renamed or deleted. Windows can
    only return to it by name, but does not allow renaming or deleting the current folder.
    """
    if not hasattr(os, "fchdir"):
        with chdir(folder):
            yield
        return
    before = os.open(".", getattr(os, "O_PATH", os.O_RDONLY))
    try:
        os.chdir(folder)
        yield
    finally:
        os.fchdir(before)
        os.close(before)
