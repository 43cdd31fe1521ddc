"""Which exit code and which one line a fault ends the command with.

0 done, 1 a fault of stylerf itself or a check that does not hold, 2 usage, 3 bad input (also where an optimization
diverges on it), 4 artifact damaged or stale, 5 out of resources, 130 interrupted.
"""

import errno
import os
import platform
import shlex
import tempfile
import traceback
from datetime import datetime
from pathlib import Path

from schemas.errors import OutOfResources, StylerfError
from stages.pipeline.distributed import launched
from stylerf_cli.output import write_fault

FAILED, BAD_INPUT, OUT_OF_RESOURCES, INTERRUPTED = 1, 3, OutOfResources.exit_code, 130
_FAILING = {errno.EIO, errno.ESTALE, errno.ENODEV, errno.ETIMEDOUT, errno.ENOTCONN}
_NO_PATH = {errno.ENAMETOOLONG, errno.ELOOP, errno.ENOTDIR, errno.EISDIR, errno.EILSEQ, errno.EINVAL}


def told(error: BaseException, argv: list[str], work: Path | None) -> tuple[int, str]:
    """Exit code and one line for any exception; a traceback that nobody expected goes to a file named in the line."""
    if isinstance(error, StylerfError):
        return error.exit_code, _one_line(error)
    if isinstance(error, KeyboardInterrupt):
        why = ", by hand or because another process of the run has ended" if launched() > 1 else ""
        return INTERRUPTED, f"interrupted{why}; the same command goes on where it stopped: stylerf {shlex.join(argv)}"
    if isinstance(error, MemoryError):
        return OUT_OF_RESOURCES, "out of memory; use smaller images or a smaller capacity, or free memory"
    if refusal := _refusal_of_disk(error):
        return OUT_OF_RESOURCES, refusal
    from stylerf.errors import Diverged, InvalidValue  # late: `--help` must not wait for what stylerf may import

    if isinstance(error, InvalidValue):
        return BAD_INPUT, _one_line(error)
    if isinstance(error, Diverged):
        return FAILED, f"{_one_line(error)}; try another --seed or a smaller learning rate"
    if unusable := _unusable_path(error):
        return BAD_INPUT, unusable
    log = _write_crash_log(error, argv, work)
    return FAILED, f"unexpected {type(error).__name__}: {_one_line(error)[:200]}; the full report is in {log}"


def _refusal_of_disk(error: BaseException) -> str | None:
    from schemas.atomic_write import out_of_resources

    if not isinstance(error, OSError):
        return None
    if error.errno in _FAILING:
        return f"{error.filename or 'a disk'} cannot be read or written ({error.strerror}); see to it and run the same"
    refusal = out_of_resources(error, os.curdir)
    return str(refusal) if refusal else None


def _unusable_path(error: BaseException) -> str | None:
    """In words, where the system takes no such path: one that is too long, runs in circles, or is no text."""
    if isinstance(error, OSError) and error.errno in _NO_PATH and isinstance(error.filename, str):
        name = error.filename if len(error.filename) <= 200 else f"{error.filename[:200]}..."
        return f"{name} cannot be used ({error.strerror}); name another"
    if isinstance(error, FileNotFoundError) and error.filename is None and _nowhere():
        return "the current folder is no longer there; change to one that is (`cd`) and run the same command"
    if isinstance(error, RuntimeError) and str(error) == "Could not determine home directory.":
        return "a path begins with ~ and a user who is not known here; write the path out"
    if isinstance(error, UnicodeEncodeError):
        return f"{error.object[:200]!r} cannot be used as a path: it is no valid Unicode; rename it"
    if isinstance(error, ValueError) and str(error) == "embedded null byte":
        return "a path holds a null byte; correct it"
    return None


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _nowhere() -> bool:
    try:
        os.getcwd()
    except OSError:
        return True
    return False


def _write_crash_log(error: BaseException, argv: list[str], work: Path | None) -> str:
    name = f"stylerf-crash-{datetime.now():%Y%m%d-%H%M%S}.log"
    text = "\n".join(
        [
            f"command: stylerf {shlex.join(argv)}",
            f"system: {platform.platform()}",
            f"versions: {_versions()}",
            "".join(traceback.format_exception(error)),
        ]
    )
    for folder in [work, _temporary()]:
        if folder is not None:
            try:
                with open(folder / name, "x", encoding="utf-8", errors="backslashreplace") as stream:
                    stream.write(text)
            except OSError:
                continue
            return str(folder / name)
    write_fault(text)
    return "the lines above, as no folder could be written to"


def _temporary() -> Path | None:
    try:
        return Path(tempfile.gettempdir())
    except OSError:  # where none can be written to
        return None


def _versions() -> str:
    try:
        from stages.run.runner import versions

        return str(versions())
    except Exception as error:  # what keeps a library from loading may be the very fault
        return f"unknown ({error})"
