"""Which exit code and which one line a fault ends the command with.

0 done, 1 a fault of stylerf itself or a check that does not hold, 2 usage, 3 bad input (also where an optimisation
diverges on it), 4 artefact damaged or stale, 5 out of resources, 130 interrupted.
"""

import platform
import shlex
import sys
import tempfile
import traceback
from datetime import datetime
from pathlib import Path

from schemas.errors import OutOfResources, StylerfError
from stylerf_cli.joining import launched

FAILED, BAD_INPUT, OUT_OF_RESOURCES, INTERRUPTED = 1, 3, OutOfResources.exit_code, 130


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
    log = _write_crash_log(error, argv, work)
    return FAILED, f"unexpected {type(error).__name__}: {_one_line(error)[:200]}; the full report is in {log}"


def _refusal_of_disk(error: BaseException) -> str | None:
    from schemas.atomic import out_of_resources

    refusal = out_of_resources(error, Path.cwd()) if isinstance(error, OSError) else None
    return str(refusal) if refusal else None


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _write_crash_log(error: BaseException, argv: list[str], work: Path | None) -> str:
    from stages.runner import versions

    name = f"stylerf-crash-{datetime.now():%Y%m%d-%H%M%S}.log"
    text = "\n".join(
        [
            f"command: stylerf {shlex.join(argv)}",
            f"system: {platform.platform()}",
            f"versions: {versions()}",
            "".join(traceback.format_exception(error)),
        ]
    )
    for folder in [work, Path(tempfile.gettempdir())]:
        if folder is not None and folder.is_dir():
            try:
                (folder / name).write_text(text, "utf-8", "backslashreplace")
            except OSError:
                continue
            return str(folder / name)
    sys.stderr.write(text)
    return "the lines above, as no folder could be written to"
