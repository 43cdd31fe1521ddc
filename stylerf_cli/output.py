"""Keeps stdout for the one JSON object of `--json`, whatever libraries print meanwhile."""

import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from schemas.canonical import plain


@contextmanager
def stdout_kept_free(active: bool) -> Iterator[None]:
    """Inside the block whatever is written to stdout, by Python or by native code, goes to stderr (if `active`)."""
    if not active:
        yield
        return
    stdout = sys.stdout
    descriptor = _descriptor(stdout)
    saved = None
    if descriptor is not None:
        stdout.flush()
        saved = os.dup(descriptor)
        os.dup2(2, descriptor)
    sys.stdout = sys.stderr
    try:
        yield
    finally:
        sys.stdout = stdout
        if saved is not None:
            os.dup2(saved, descriptor)
            os.close(saved)


def _descriptor(stream: Any) -> int | None:
    try:
        return stream.fileno()
    except (AttributeError, OSError, ValueError):  # replaced by a buffer, as under pytest or in a notebook
        return None


class OutputClosed(Exception):
    """Whoever read our stdout (`| head`) has closed it."""


def write_out(text: str) -> None:
    """Writes to stdout at once, names of files that are no text by their own bytes.

    OutputClosed where nobody reads it any more: no fault of a stage is taken for that.
    """
    if hasattr(sys.stdout, "reconfigure"):
        sys.stdout.reconfigure(errors="surrogateescape")
    try:
        sys.stdout.write(text)
        sys.stdout.flush()
    except BrokenPipeError as error:
        raise OutputClosed from error


def print_json(value: Any) -> None:
    """Prints one JSON object and a newline on stdout; NaN and infinity become strings.

    What stdout cannot write as text is escaped, as JSON has it: a name of a file may be none.
    """
    text = json.dumps(plain(value), ensure_ascii=False, allow_nan=False)
    try:
        text.encode(sys.stdout.encoding or "utf-8")
    except UnicodeEncodeError:
        text = json.dumps(plain(value), allow_nan=False)
    write_out(text + "\n")
