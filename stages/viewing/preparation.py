"""Prepares the first selection in a field while the page is idle: renders the training views."""

import threading
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from schemas.errors import StylerfError
from stages.viewing.display import Display
from stages.viewing.runs import ENDING_SECONDS
from stylerf.errors import InvalidValue

if TYPE_CHECKING:  # imports torch, which must not delay the first picture
    from stages.viewing.growing import Grower

LOOK_SECONDS = 0.2  # between checks whether the page is idle


class Preparation:
    """Provides what grows selections in the shown field.

    Attributes:
        say: Receives notes for the user.
    """

    def __init__(self, display: Display, threads: int, say: Callable[[str], None]) -> None:
        self._display, self._threads, self.say = display, threads, say
        self._growers: dict[str, Grower] = {}  # of the shown field, by digest
        self._growing = threading.Lock()  # over _growers
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None

    def grower(self) -> "Grower":
        """Return what grows selections in the shown field; unless prepared, its first selection takes seconds."""
        from stages.viewing.growing import Grower

        library, field = self._display.library, self._display.field
        key = library.work.get("field", field).digest
        with self._growing:
            if key not in self._growers:
                self._growers = {key: Grower(library, field, self._threads, self.say)}
            return self._growers[key]

    def start(self) -> None:
        """From now on prepare each shown field in a thread, while no picture is being waited for."""
        with self._display.lock:
            if self._thread is None:
                self._thread = threading.Thread(target=self._work, name="prepare", daemon=True)
                self._thread.start()

    def close(self) -> None:
        """End the thread."""
        self._closing.set()
        if self._thread is not None:
            self._thread.join(ENDING_SECONDS)

    def _work(self) -> None:
        done = ""
        while not self._closing.wait(LOOK_SECONDS):
            field = self._display.field
            if field == done or not self._display.painter.resting():
                continue
            try:
                if self.grower().prepare(partial(self._idle_with, field)):
                    done = field
            except (StylerfError, InvalidValue, ValueError, OSError, MemoryError):
                done = field  # a click reports what is wrong

    def _idle_with(self, field: str) -> bool:
        """Wait until no picture is being waited for; return whether this field is still shown."""
        while not self._closing.is_set() and self._display.field == field:
            if self._display.painter.resting():
                return True
            self._closing.wait(LOOK_SECONDS)
        return False
