"""Locks: one writer, whoever deletes or links what; a file that is not a lock is never written to."""

import errno
import multiprocessing
import os
import socket
import stat

import pytest

from schemas import lock
from schemas.errors import OutOfResources, WouldBeLost
from schemas.lock import Lock
from schemas.work_folder import Recipe, WorkFolder

RECIPE = Recipe("toy", 1, {}, [])


def hold(root, ready, done):
    begun = WorkFolder(root).begin("field", "fit", RECIPE)
    ready.set()
    done.wait(20)
    begun.release()


@pytest.fixture
def other_process(tmp_path):
    """Another process that writes field `fit` below tmp_path."""
    context = multiprocessing.get_context("fork")
    ready, done = context.Event(), context.Event()
    child = context.Process(target=hold, args=(tmp_path, ready, done))
    child.start()
    assert ready.wait(20)
    yield child
    done.set()
    child.join()


def test_the_message_names_the_holders_process_and_host(tmp_path, other_process):
    with pytest.raises(OutOfResources, match=f"process .{other_process.pid} on {socket.gethostname()}"):
        WorkFolder(tmp_path).begin("field", "fit", RECIPE)


def test_deleting_the_lock_file_lets_no_second_writer_in(tmp_path, other_process):
    (tmp_path / "field" / ".fit.lock").unlink()
    with pytest.raises(OutOfResources, match="another process"):
        WorkFolder(tmp_path).begin("field", "fit", RECIPE)


def test_a_lock_file_deleted_while_it_is_taken_is_taken_again(tmp_path, monkeypatch):
    path, real, calls = tmp_path / ".a.lock", lock.lock_descriptor, []

    def deleting(handle, **how):
        if not calls:
            path.unlink()
        calls.append(how)
        return real(handle, **how)

    monkeypatch.setattr(lock, "lock_descriptor", deleting)
    held = Lock(path)
    assert len(calls) == 2 and path.is_file()
    held.release()


@pytest.mark.parametrize("kind", ["link", "hard link", "pipe", "folder", "document", "letter", "link to nothing"])
def test_what_is_not_a_lock_file_is_left_alone(tmp_path, kind):
    letter, path = tmp_path / "letter.txt", tmp_path / "field" / ".fit.lock"
    letter.write_text("Dear Sir")
    path.parent.mkdir()
    made = {
        "link": lambda: path.symlink_to(letter),
        "link to nothing": lambda: path.symlink_to(tmp_path / "new"),
        "hard link": lambda: os.link(letter, path),
        "pipe": lambda: os.mkfifo(path),
        "folder": path.mkdir,
        "document": lambda: path.write_text("Dear Madam"),
        "letter": lambda: path.write_text("x"),
    }
    made[kind]()
    with pytest.raises(WouldBeLost, match=r"\.fit\.lock is not a stylerf lock file"):
        WorkFolder(tmp_path).begin("field", "fit", RECIPE)
    assert letter.read_text() == "Dear Sir" and not (tmp_path / "new").exists()
    assert {"document": "Dear Madam", "letter": "x"}.get(kind) in (None, path.is_file() and path.read_text())


def test_a_lock_in_a_groups_folder_can_be_taken_by_its_members(tmp_path):
    tmp_path.chmod(0o2770)
    before = os.umask(0o022)
    try:
        Lock(tmp_path / ".a.lock").release()
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / ".a.lock").stat().st_mode) == 0o660


@pytest.mark.skipif(os.geteuid() != 0, reason="gives a file to another user")
def test_a_lock_of_another_user_counts_where_others_may_write(tmp_path):
    path = tmp_path / ".a.lock"
    path.write_text("1\n")
    os.chown(path, 12345, 12345)
    path.chmod(0o644)
    tmp_path.chmod(0o777)

    def taken() -> bool:
        child = os.fork()
        if child == 0:
            os.setuid(23456)
            try:
                Lock(path)
                os._exit(0)
            except BaseException:
                os._exit(1)
        return os.waitpid(child, 0)[1] == 0

    for folder in tmp_path.parents:  # pytest's own folders are closed to others
        if folder.stat().st_uid == 0 and folder.name.startswith("pytest-"):
            folder.chmod(0o755)
    assert taken()
    tmp_path.chmod(0o755)
    assert not taken()


def test_a_disk_that_locks_only_files_still_works(tmp_path, monkeypatch):
    real = lock.lock_descriptor

    def files_only(handle, **how):
        if stat.S_ISDIR(os.fstat(handle).st_mode):
            raise OSError(errno.EBADF, "")
        return real(handle, **how)

    monkeypatch.setattr(lock, "lock_descriptor", files_only)
    assert WorkFolder(tmp_path).begin("field", "fit", RECIPE).commit().name == "fit"
    held = WorkFolder(tmp_path).begin("field", "b", RECIPE)
    with pytest.raises(OutOfResources, match="another process"):  # the lock file alone still keeps others out
        WorkFolder(tmp_path).begin("field", "b", RECIPE)
    held.discard()


def test_a_folder_without_write_permission_is_reported(tmp_path, monkeypatch):
    """As the system answers whoever is not root: no permission to make the file, which is then not there to be read."""
    real = os.open

    def refusing(path, flags, *more, **named):
        if flags & os.O_CREAT and str(path).endswith(".lock"):
            raise PermissionError(13, "Permission denied", str(path))
        return real(path, flags, *more, **named)

    monkeypatch.setattr(lock.os, "open", refusing)
    with pytest.raises(OutOfResources, match="no permission for"):
        lock.Lock(tmp_path / ".x.lock")
