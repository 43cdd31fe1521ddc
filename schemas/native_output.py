"""Silences native libraries: libpng, OpenEXR and libjpeg print errors that they also return.

Their lines would mix with ours and, on stdout, break the single JSON object that `--json` promises.
"""

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager

_lock = threading.Lock()
_depth = 0
_saved: tuple[int, int] | None = None


@contextmanager
def native_output_silenced() -> Iterator[None]:
    """Redirect file descriptors 1 and 2 to the null device inside the block; blocks may overlap across threads."""
    _enter()
    try:
        yield
    finally:
        _leave()


@contextmanager
def native_output_restored() -> Iterator[None]:
    """Restore file descriptors 1 and 2 after the block, so that a command's last messages are printed.

    Needed if an interruption cut short the start or end of native_output_silenced, or a thread is still inside one.
    """
    try:
        yield
    finally:
        with _lock:
            _restore()


@contextmanager
def native_output_audible() -> Iterator[None]:
    """Let the command print inside the block even if other threads are inside native_output_silenced.

    Must not be entered from inside a silenced block's own native call, nor nested.
    """
    with _lock:
        if (saved := _saved) is None:
            yield
            return
        for number, copy in zip((1, 2), saved):
            os.dup2(copy, number)
        try:
            yield
        finally:
            _silence()


def _enter() -> None:
    global _depth, _saved  # noqa: PLW0603 - descriptors belong to the process, so the count of users does too
    with _lock:
        _depth += 1
        if _depth > 1:
            return
        try:
            _saved = (os.dup(1), os.dup(2))
        except OSError:  # closed, as in a daemon: nothing to silence
            _saved = None
            return
        _silence()


def _silence() -> None:
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    os.close(nowhere)


def _leave() -> None:
    global _depth  # noqa: PLW0603 - see _enter
    with _lock:
        _depth -= 1
        if not _depth:
            _restore()


def _restore() -> None:
    """Restore the descriptors; may be interrupted and called again."""
    global _saved  # noqa: PLW0603 - see _enter
    if (saved := _saved) is None:
        return
    for number, copy in zip((1, 2), saved):
        os.dup2(copy, number)
    _saved = None
    for copy in saved:
        os.close(copy)
