"""Time and peak memory of a run, interruptions included."""

import json
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

from schemas.atomic_write import write_json
from schemas.errors import OutOfResources

try:
    import resource
except ImportError:  # Windows
    resource = None  # type: ignore[assignment]

SAVED_EVERY_SECONDS = 2.0
_RSS_UNIT = 1 if sys.platform == "darwin" else 1024  # bytes


def _reset_peak() -> None:
    """Reset the peak memory of the process (Linux), so that a stage does not inherit the peak of the one before."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def peak_memory_mb() -> float:
    """Return the peak resident memory of this process since the last reset, in MB = 1e6 bytes."""
    with suppress(OSError, ValueError, StopIteration):
        lines = Path("/proc/self/status").read_text().splitlines()
        return int(next(line for line in lines if line.startswith("VmHWM:")).split()[1]) * 1024 / 1e6
    if resource is None:
        import psutil

        return psutil.Process().memory_info().peak_wset / 1e6
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * _RSS_UNIT / 1e6


def _children_peak_mb() -> float:
    if resource is None:  # Windows does not record them
        return 0.0
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * _RSS_UNIT / 1e6


class Clock:
    """Measures while entered; saves `clock.json` every two seconds, so that a kill loses no more than that."""

    def __init__(self, folder: Path, resumed: bool) -> None:
        self._file = folder / "clock.json"
        self._before = self._earlier() if resumed else {"seconds": 0.0, "peak_memory_mb": 0.0, "runs": 0}
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._save_often, name="clock", daemon=True)

    def _earlier(self) -> dict[str, float]:
        try:
            stored = json.loads(self._file.read_bytes())
            return {"runs": int(stored["runs"])} | {k: float(stored[k]) for k in ("seconds", "peak_memory_mb")}
        except (OSError, ValueError, KeyError, TypeError):
            return {"seconds": 0.0, "peak_memory_mb": 0.0, "runs": 1}

    def __enter__(self) -> "Clock":
        _reset_peak()
        self._children_before = _children_peak_mb()
        self._start = time.perf_counter()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        # Joined before the last save, or the thread could write an older reading over it.
        self._thread.join()
        self._save()

    @property
    def seconds(self) -> float:
        """Wall time of this run and the interrupted runs before it, seconds."""
        return self._before["seconds"] + time.perf_counter() - self._start

    @property
    def peak_mb(self) -> float:
        """Peak memory of this process, its children and the interrupted runs, MB."""
        children = _children_peak_mb()
        # The system keeps the peak of all children so far: an earlier stage's must not be charged to this one.
        grown = children if children > self._children_before else 0.0
        return max(self._before["peak_memory_mb"], peak_memory_mb(), grown)

    @property
    def runs(self) -> int:
        """Number of runs, including this one."""
        return int(self._before["runs"]) + 1

    def _save_often(self) -> None:
        while not self._stop.wait(SAVED_EVERY_SECONDS):
            self._save()

    def _save(self) -> None:
        # The stage reports a full disk; a measurement is not worth aborting a run.
        with suppress(OutOfResources, OSError):
            if self._file.parent.is_dir():
                write_json(self._file, {"seconds": self.seconds, "peak_memory_mb": self.peak_mb, "runs": self.runs})
