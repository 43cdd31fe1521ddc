"""Exit code and error line of a command.

0 done, 1 an error in stylerf itself or a failed check, 2 usage, 3 bad input (or an optimization that diverges on it),
4 artifact damaged or stale, 5 out of resources, 130 interrupted.
"""

import errno
import os
import platform
import shlex
import tempfile
import traceback
from datetime import datetime
from pathlib import Path

from schemas.errors import OutOfResources, StylerfError, one_line
from stages.pipeline.distributed import launched
from stylerf_cli.output import write_fault

FAILED, BAD_INPUT, OUT_OF_RESOURCES, INTERRUPTED = 1, 3, OutOfResources.exit_code, 130
_FAILING = {errno.EIO, errno.ESTALE, errno.ENODEV, errno.ETIMEDOUT, errno.ENOTCONN}
_NO_PATH = {errno.ENAMETOOLONG, errno.ELOOP, errno.ENOTDIR, errno.EISDIR, errno.EILSEQ, errno.EINVAL}


def code_and_line(error: BaseException, argv: list[str], work: Path | None) -> tuple[int, str]:
    """Return exit code and error line of an exception.

    The traceback of an unexpected one goes to a file named in the line.
    """
    if isinstance(error, StylerfError):
        return error.exit_code, one_line(error)
    if isinstance(error, KeyboardInterrupt):
        why = ", by hand or because another process of the run has ended" if launched() > 1 else ""
        return INTERRUPTED, f"interrupted{why}; rerun to resume: stylerf {shlex.join(argv)}"
    if isinstance(error, MemoryError):
        return OUT_OF_RESOURCES, "out of memory; use smaller images or a smaller capacity, or free memory"
    if refusal := _refusal_of_disk(error):
        return OUT_OF_RESOURCES, refusal
    from stylerf.errors import Diverged, InvalidValue  # imported late: `--help` must not wait for it

    if isinstance(error, InvalidValue):
        return BAD_INPUT, one_line(error)
    if isinstance(error, Diverged):
        return FAILED, f"{one_line(error)}; try another --seed or a smaller learning rate"
    if unusable := _unusable_path(error):
        return BAD_INPUT, unusable
    log = _write_crash_log(error, argv, work)
    return FAILED, f"unexpected {type(error).__name__}: {one_line(error)[:200]}; the full report is in {log}"


def _refusal_of_disk(error: BaseException) -> str | None:
    from schemas.atomic_write import out_of_resources

    if not isinstance(error, OSError):
        return None
    if error.errno in _FAILING:
        return f"{error.filename or 'a disk'} cannot be read or written ({error.strerror}); fix that and rerun"
    refusal = out_of_resources(error, os.curdir)
    return str(refusal) if refusal else None


def _unusable_path(error: BaseException) -> str | None:
    """Return the error line for a path that the system rejects: too long, circular, or not text."""
    if isinstance(error, OSError) and error.errno in _NO_PATH and isinstance(error.filename, str):
        name = error.filename if len(error.filename) <= 200 else f"{error.filename[:200]}..."
        return f"{name} cannot be used ({error.strerror}); give another path"
    if isinstance(error, FileNotFoundError) and error.filename is None and _nowhere():
        return "the current folder no longer exists; change to another one (`cd`) and rerun"
    if isinstance(error, RuntimeError) and str(error) == "Could not determine home directory.":
        return "a path begins with ~ and an unknown user; write the path out"
    if isinstance(error, UnicodeEncodeError):
        return f"{error.object[:200]!r} cannot be used as a path: it is not valid Unicode; rename it"
    if isinstance(error, ValueError) and str(error) == "embedded null byte":
        return "a path contains a null byte; correct it"
    return None


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
    return "the lines above, because no folder is writable"


def _temporary() -> Path | None:
    try:
        return Path(tempfile.gettempdir())
    except OSError:  # none is writable
        return None


def _versions() -> str:
    try:
        from stages.run.runner import versions

        return str(versions())
    except Exception as error:  # a library that cannot be loaded may be the cause itself
        return f"unknown ({error})"
