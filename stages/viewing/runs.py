"""Runs of other commands: each in a separate process, which outlives the page and resumes when it is run again."""

import os
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Sequence

from schemas.errors import UsageError, one_line
from stages.viewing.commands import script_of

# Without -P, `-m` imports from the current folder first, whose files may be untrusted.
PROGRAM = (sys.executable, "-P", "-m", "stylerf_cli.main")
KEPT_LINES = 200
ENDING_SECONDS = 30.0  # time that a stopped run has for its last checkpoint


class Run:
    """A command in progress.

    Attributes:
        arguments: Of `stylerf`, without the common ones.
        lines: Its output, the latest last.
        code: Its exit code, None while it runs.
    """

    def __init__(
        self,
        arguments: Sequence[str],
        common: Sequence[str],
        said: Callable[["Run"], None],
        ended: Callable[["Run"], None],
        program: Sequence[str] = PROGRAM,
    ) -> None:
        """Start it.

        Args:
            common: further arguments, such as --threads 2.
            said: called after each line.
            ended: called once, after the last.
        """
        self.arguments = list(arguments)
        self.code: int | None = None
        self.lines: deque[str] = deque(maxlen=KEPT_LINES)
        self.stopped = False
        self._said, self._ended = said, ended
        environment = os.environ | {"PYTHONUNBUFFERED": "1"}
        self._process = subprocess.Popen(
            [*program, *arguments, *common],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            env=environment,
            start_new_session=True,  # Ctrl-C on the viewer's terminal reaches it through stop(), once
        )
        self._thread = threading.Thread(target=self._follow, name="run", daemon=True)
        self._thread.start()

    @property
    def last(self) -> str:
        """Its last line of output, empty before the first."""
        return self.lines[-1] if self.lines else ""

    def stop(self) -> None:
        """Interrupt it as Ctrl-C does: it saves a checkpoint and ends, and the same command resumes it."""
        if self.code is None and not self.stopped:
            self.stopped = True
            self._process.send_signal(signal.SIGINT)

    def wait(self, seconds: float = ENDING_SECONDS) -> int | None:
        """Wait for its end; return the exit code, None if it has not ended."""
        self._thread.join(seconds)
        return self.code

    def _follow(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line := line.strip():
                self.lines.append(line)
                self._tell(self._said)
        self._process.stdout.close()
        self.code = self._process.wait()
        self._tell(self._ended)

    def _tell(self, whom: Callable[["Run"], None]) -> None:
        """Call back; an error there does not end the run, but becomes one of its lines."""
        try:
            whom(self)
        except Exception as error:
            self.lines.append(f"the page could not show this run: {one_line(error)}")


class Runs:
    """The commands of a session, one at a time.

    Attributes:
        present: The last one started, None before the first.
        commands: All of them, for the session's script.
    """

    def __init__(self, common: Sequence[str] = (), changed: Callable[[], None] = lambda: None) -> None:
        """Start without any.

        Args:
            common: arguments that every command gets, such as --threads 2.
            changed: called when runs have begun, spoken or ended.
        """
        self._common, self._changed, self._lock = common, changed, threading.RLock()
        self.present: Run | None = None
        self.commands: list[list[str]] = []

    def start(self, arguments: list[str], ended: Callable[[Run], None] = lambda run: None) -> Run:
        """Run a command, and record it for the session's script.

        Raises:
            UsageError: another one is still running.
        """
        with self._lock:
            if self.present is not None and self.present.code is None:
                verb = self.present.arguments[0]
                raise UsageError(f"`stylerf {verb}` is still running; stop it, or wait for it to finish")
            if arguments not in self.commands[-1:]:
                self.commands.append(arguments)

            def end(run: Run) -> None:
                try:
                    self._changed()
                finally:
                    ended(run)

            self.present = Run(arguments, self._common, lambda run: self._changed(), end)
            self._changed()
            return self.present

    def stop(self) -> None:
        """Interrupt the current one; the same command resumes it."""
        if self.present is not None:
            self.present.stop()

    def close(self) -> None:
        """Interrupt the current one and wait for its checkpoint."""
        if self.present is not None and self.present.code is None:
            self.present.stop()
            self.present.wait()

    def script(self) -> str:
        """Return the session's commands as a shell script."""
        return script_of(map(self.whole, self.commands))

    def whole(self, arguments: Sequence[str]) -> list[str]:
        """Return the arguments of a command with those that every command gets."""
        return [*arguments, *self._common]
