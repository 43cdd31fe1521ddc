"""What reaches stdout: lines without control characters of names in them, or the one JSON object of `--json` alone."""

import json
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any

from schemas.canonical_json import plain
from schemas.safe_names import printable


def open_standard_streams() -> None:
    """Opens what of stdin, stdout and stderr was closed before we were started (`>&-`), to nowhere.

    The next file that is opened would take its number else, and what is printed would go into that file.
    """
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        try:
            os.fstat(number)
        except OSError:
            os.dup2(os.open(os.devnull, os.O_RDWR), number, inheritable=True)
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, mode, errors="backslashreplace", closefd=False))
        if os.name == "nt" and hasattr(getattr(sys, name), "reconfigure"):
            getattr(sys, name).reconfigure(encoding="utf-8")  # a pipe there has an encoding of the country's


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


def write_lines(lines: Sequence[str]) -> None:
    """Writes lines to stdout; what would move the cursor, break a line or turn the text round in one is escaped."""
    write_out("".join(f"{printable(line)}\n" for line in lines))


def write_out(text: str) -> None:
    """Writes to stdout at once; what its encoding does not have is escaped.

    OutputClosed where nobody reads it any more: no fault of a stage is taken for that.
    """
    if hasattr(sys.stdout, "reconfigure"):
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        sys.stdout.write(text)
        sys.stdout.flush()
    except BrokenPipeError as error:
        raise OutputClosed from error


def write_fault(text: str) -> None:
    """Writes to stderr, line by line; nobody may be reading: the exit code still tells."""
    with suppress(OSError, ValueError):
        sys.stderr.write("".join(f"{printable(line)}\n" for line in text.splitlines()))
        sys.stderr.flush()


def print_json(value: Any) -> None:
    """Prints one JSON object and a newline on stdout, all in ASCII; NaN and infinity become strings."""
    write_out(json.dumps(plain(value), allow_nan=False) + "\n")
