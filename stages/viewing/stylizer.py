"""Stylizing from the page: the command of a request, its run shown from checkpoints, stopped and saved."""

import threading
import time
from collections.abc import Callable
from dataclasses import replace

from schemas.errors import UsageError
from stages.viewing.display import Display
from stages.viewing.runs import Run, Runs
from stages.viewing.shown import Source
from stages.viewing.styles import Wish
from stylerf.fields.palette_edits import PaletteEdits

WATCH_SECONDS = 3.0  # between checks for new checkpoints of a stylization


class Stylizer:
    """Stylizes the shown field, or a region of it."""

    def __init__(self, display: Display, runs: Runs) -> None:
        self._display, self._library, self._runs = display, display.library, runs

    def command(self, wish: Wish) -> list[str]:
        """Return the command of a stylization."""
        return wish.command(self._library.work.root, self._display.field)

    def watch(self, run: Run, name: str, region: str = "") -> None:
        """Show a stylization of the scene or a region while it runs, from its checkpoints, in a separate thread."""
        from stages.viewing.half_done import half_done, half_learned
        from stages.viewing.recoloring import edited_field

        display, source, work = self._display, self._display.source(), self._library.work
        cells = self._library.region(region) if region else None

        def newest() -> Source | None:
            if cells is None:
                return half_done(work, name, source)
            edit = half_learned(work, name)
            if edit is None:
                return None
            return replace(source, field=edited_field(source.field, edit, cells, PaletteEdits()))

        def follow() -> None:
            while run.code is None:
                time.sleep(WATCH_SECONDS)
                found = newest()
                with display.lock:
                    if found is not None and run.code is None:
                        display.in_progress = found
                        display.refresh()
            with display.lock:
                display.in_progress = None
                display.refresh()

        threading.Thread(target=follow, name="watch", daemon=True).start()

    def keep(self, ended: Callable[[Run], None] = lambda run: None) -> Run:
        """Stop the stylization of a scene, if it is running, and make a field from the steps taken so far.

        Raises:
            UsageError: as keep_command.
        """
        run = self._runs.present
        if run is not None and run.arguments[0] == "stylize" and run.code is None:
            run.stop()
            run.wait()
        return self._runs.start(self.keep_command(), ended)

    def keep_command(self) -> list[str]:
        """Return the command that finishes a stopped stylization where it is: the same, until the steps taken so far.

        Raises:
            UsageError: none was stopped, or it has no steps to keep.
        """
        from stages.viewing.half_done import steps_done

        run = self._runs.present
        if run is None or run.arguments[0] != "stylize" or "--region" in run.arguments or run.code == 0:
            raise UsageError("no scene stylization was stopped, so there is nothing to keep")
        if run.code is None:
            raise UsageError("the stylization is still running: stop it first")
        options = dict(zip(run.arguments, run.arguments[1:], strict=False))
        steps = steps_done(self._library.work, options.get("--name", ""))
        if steps is None:
            raise UsageError("the stopped run has no finished style step, or no name to keep it under: resume it")
        made = run.arguments
        if "--until" in made:
            at = made.index("--until")
            made = [*made[:at], *made[at + 2 :]]
        return [*made, "--until", str(steps)]
