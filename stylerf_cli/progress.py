"""Progress on stderr: a bar on a terminal, occasional lines elsewhere, nothing for the first two seconds."""

import os
import time
from collections import deque
from collections.abc import Callable
from typing import TextIO

from schemas.native_output import native_output_audible
from schemas.safe_names import printable

SHOWN_AFTER_SECONDS = 2.0
REDRAW_SECONDS = 0.1
LINE_EVERY_SECONDS = 5.0
RATE_WINDOW_SECONDS = 15.0
# Lowest assumed rate of a time budget: compiling is not part of it, and would inflate the remaining time.
MIN_BUDGET_RATE = 0.5
BAR_WIDTH = 24


class Bars:
    """Shows progress on a stream (a stages.run.progress.Progress). clock: in seconds; tests replace it."""

    def __init__(self, stream: TextIO, clock: Callable[[], float] = time.monotonic) -> None:
        self._stream, self._clock = stream, clock
        self._terminal = stream.isatty()
        unicode = "utf" in (getattr(stream, "encoding", None) or "").lower()
        self._full, self._empty = ("█", "░") if unicode else ("#", ".")
        self._open = False
        self._unread = False  # the reader of the stream has closed it
        self._drawn = False  # the terminal's last line is an unfinished bar

    def start(self, label: str, total: float | None = None, unit: str = "step") -> None:
        """Open a bar, closing the one before."""
        self.finish()
        self._label, self._total, self._unit = label, total, unit
        self._open, self._shown = True, False
        self._done, self._note = 0.0, ""
        self._began = self._last = self._clock()
        self._recent: deque[tuple[float, float]] = deque()

    def update(self, done: float, note: str = "") -> None:
        """Report that `done` units are finished."""
        if not self._open:
            return
        now = self._clock()
        self._done, self._note = done, note or self._note
        self._recent.append((now, done))
        while len(self._recent) > 2 and self._recent[1][0] < now - RATE_WINDOW_SECONDS:
            self._recent.popleft()
        pause = REDRAW_SECONDS if self._terminal else LINE_EVERY_SECONDS
        if now - self._began < SHOWN_AFTER_SECONDS or (self._shown and now - self._last < pause):
            return
        self._shown, self._last = True, now
        if self._terminal:
            self._draw(self._line(now, bar=True))
        else:
            self._write(self._line(now, bar=False))

    def finish(self) -> None:
        """Close the bar; one that was shown leaves a line with its time."""
        if not self._open:
            return
        self._open = False
        if not self._shown and self._clock() - self._began < SHOWN_AFTER_SECONDS:
            return
        seconds = self._clock() - self._began
        parts = [f"{self._label}: {self._amount(self._done)} in {duration(seconds)}"]
        self._clear()
        self._write(", ".join(parts + ([self._note] if self._note else [])))

    def say(self, text: str) -> None:
        """Print a line above the open bar."""
        self._clear()
        self._write(text)

    def _amount(self, value: float) -> str:
        if self._unit == "s":
            return duration(value)
        number = f"{value:,.0f}" if value == int(value) else f"{value:,.1f}"
        return f"{number} {self._unit}" + ("s" if value != 1 and not self._unit.endswith("s") else "")

    def _line(self, now: float, bar: bool) -> str:
        parts = []
        if self._total:
            share = min(1.0, self._done / self._total)
            filled = round(share * BAR_WIDTH)
            drawing = self._full * filled + self._empty * (BAR_WIDTH - filled) + " " if bar else ""
            parts.append(f"{drawing}{100 * share:3.0f} %")
        if self._unit != "s":
            of = f"/{self._total:,.0f}" if self._total else ""
            parts.append(f"{self._done:,.0f}{of}")
        rate = self._rate()
        if rate and self._unit != "s":
            parts.append(f"{rate:,.0f}/s" if rate >= 10 else f"{rate:.2g}/s")
        if self._note:
            parts.append(self._note)
        if self._total and rate:
            parts.append(f"{duration((self._total - self._done) / rate)} left")
        elif not self._total:
            parts.append(duration(now - self._began))
        return f"{self._label}: " + "  ".join(parts)

    def _rate(self) -> float:
        if len(self._recent) < 2:
            return 0.0
        (start, first), (end, last) = self._recent[0], self._recent[-1]
        lowest = MIN_BUDGET_RATE if self._unit == "s" else 0.0
        return max(lowest, (last - first) / (end - start)) if end > start else 0.0

    def _draw(self, line: str) -> None:
        try:
            with native_output_audible():
                width = os.get_terminal_size(self._stream.fileno()).columns
        except (OSError, ValueError):
            width = 80
        self._put("\r\x1b[K" + printable(line)[: max(1, width - 1)])
        self._drawn = True

    def _clear(self) -> None:
        if self._drawn:
            self._put("\r\x1b[K")
            self._drawn = False

    def _write(self, line: str) -> None:
        self._put(printable(line) + "\n")

    def _put(self, text: str) -> None:
        """Write and flush. A closed stream (`2>&1 | head`) does not end the command."""
        if self._unread:
            return
        try:
            with native_output_audible():  # threads may be decoding photos
                self._stream.write(text)
                self._stream.flush()
        except OSError:
            self._unread = True


def duration(seconds: float) -> str:
    """Format seconds for people: 0.4 s, 12 s, 3 min 20 s, 2 h 05 min."""
    seconds = max(0.0, seconds)
    if seconds < 9.95:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"
