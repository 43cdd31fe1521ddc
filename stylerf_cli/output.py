"""Standard output: lines with control characters escaped, or the JSON object of `--json` alone."""

import json
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

from schemas.canonical_json import plain
from schemas.safe_names import printable


def open_standard_streams() -> None:
    """Open stdin, stdout and stderr to the null device if they were closed by the parent (`>&-`).

    Otherwise the next file opened would take their descriptor and receive the output.
    """
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        try:
            os.fstat(number)
        except OSError:
            os.dup2(os.open(os.devnull, os.O_RDWR), number, inheritable=True)
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, mode, errors="backslashreplace", closefd=False))
        if os.name == "nt" and hasattr(getattr(sys, name), "reconfigure"):
            getattr(sys, name).reconfigure(encoding="utf-8")  # a pipe there has a locale-dependent encoding


@contextmanager
def stdout_redirected(active: bool) -> Iterator[None]:
    """Send what Python or native code writes to stdout inside the block to stderr, if `active`."""
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
        if saved is not None and descriptor is not None:
            os.dup2(saved, descriptor)
            os.close(saved)


def _descriptor(stream: Any) -> int | None:
    try:
        return int(stream.fileno())
    except (AttributeError, OSError, ValueError):  # a buffer, as under pytest or in a notebook
        return None


class OutputClosed(Exception):
    """The reader of stdout (`| head`) has closed it."""


def write_lines(lines: Sequence[str]) -> None:
    """Write lines to stdout, escaping control and bidirectional characters."""
    write_out("".join(f"{printable(line)}\n" for line in lines))


def write_out(text: str) -> None:
    """Write to stdout and flush, escaping what its encoding lacks; OutputClosed if nobody reads it anymore."""
    if hasattr(sys.stdout, "reconfigure"):
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        sys.stdout.write(text)
        sys.stdout.flush()
    except BrokenPipeError as error:
        raise OutputClosed from error


def write_fault(text: str) -> None:
    """Write lines to stderr. If nobody reads them, only the exit code remains."""
    with suppress(OSError, ValueError):
        sys.stderr.write("".join(f"{printable(line)}\n" for line in text.splitlines()))
        sys.stderr.flush()


def print_json(value: Any) -> None:
    """Print one JSON object and a newline on stdout, in ASCII; NaN and infinity become strings."""
    write_out(json.dumps(plain(value), allow_nan=False) + "\n")


if TYPE_CHECKING:  # imports numpy, which must not delay `--help`
    from schemas.work_folder import Artifact


def palette_lines(made: "Artifact", kind: str = "edit") -> list[str]:
    """Return one line per palette color, after a heading and before the path."""
    from stages.artifacts.edit import palette_entries

    colors = palette_entries(made)
    lines = [
        f"  {one['index']}  {one['now']}  {one['share']:6.1%}  {one['name']}"
        + (f" (was {one['learned']})" if one["now"] != one["learned"] else "")
        for one in colors
    ]
    return [f"{kind} {made.name}: a palette of {len(colors)} colors", *lines, f"  {made.path}"]
