"""Keeping native libraries from writing to the terminal: libpng, OpenEXR and libjpeg print what they also return.

Their lines would stand among our own and, on stdout, break the one JSON object that `--json` promises.
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
    """Sends file descriptors 1 and 2 of the process to nowhere inside the block; blocks may overlap in threads."""
    _enter()
    try:
        yield
    finally:
        _leave()


@contextmanager
def heard_in_the_end() -> Iterator[None]:
    """After the block descriptors lead where they led, also where an interruption broke off the beginning or the end of
    a silence, or a thread is still in one: what a command says last must be heard.
    """
    try:
        yield
    finally:
        with _lock:
            _restore()


def _enter() -> None:
    global _depth, _saved  # noqa: PLW0603 - descriptors belong to the process, so the count of users does too
    with _lock:
        _depth += 1
        if _depth > 1:
            return
        try:
            _saved = (os.dup(1), os.dup(2))
        except OSError:  # a daemon may have closed them: then there is nothing to silence
            _saved = None
            return
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
    """Begun anew after an interruption, it comes to the same."""
    global _saved  # noqa: PLW0603 - see _enter
    if (saved := _saved) is None:
        return
    for number, copy in zip((1, 2), saved):
        os.dup2(copy, number)
    _saved = None
    for copy in saved:
        os.close(copy)
