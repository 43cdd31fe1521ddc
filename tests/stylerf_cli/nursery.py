"""Commands as processes of their own, without each of them paying seconds for its imports.

A process that has imported the stages, but has started no thread yet, forks one child for every command. The tests'
own process cannot do that: threads that numba and torch run in it would be missing in its children.
"""

import json
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
LONGEST_SECONDS = 500.0
WITHOUT_GPUS = {"CUDA_VISIBLE_DEVICES": ""}


class Nursery:
    """Starts commands one after the other. Close it when done."""

    def __init__(self, prefix: Sequence[str] = ()) -> None:
        """prefix: a command that runs another one, such as with fewer rights."""
        self._process = subprocess.Popen(
            [*prefix, sys.executable, "-m", "tests.stylerf_cli.nursery"], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            cwd=REPOSITORY, bufsize=0, env=os.environ | WITHOUT_GPUS,
        )  # fmt: skip
        self._read = b""

    def start(
        self, folder: Path, *arguments: object, limits: dict[str, int] | None = None, held: bool = False
    ) -> "Command":
        """`stylerf ARGUMENTS`, its output kept in `folder`. limits: of resource.setrlimit, by the limit's name. held:
        it stops at once, until SIGCONT."""
        folder.mkdir(parents=True, exist_ok=True)
        order = {"argv": [str(one) for one in arguments], "folder": str(folder), "limits": limits or {}, "held": held}
        self._process.stdin.write(json.dumps(order).encode() + b"\n")
        return Command(self, int(self.line(LONGEST_SECONDS)), folder)

    def run(self, folder: Path, *arguments: object, limits: dict[str, int] | None = None) -> "Command":
        """The same, brought to its end."""
        command = self.start(folder, *arguments, limits=limits)
        command.wait()
        return command

    def line(self, seconds: float) -> str | None:
        """The next line that the process writes; None where it takes longer than that."""
        end = time.monotonic() + seconds
        while b"\n" not in self._read:
            if not select.select([self._process.stdout], [], [], max(0.0, end - time.monotonic()))[0]:
                return None
            data = self._process.stdout.read(4096)
            assert data, "the nursery died"
            self._read += data
        line, _, self._read = self._read.partition(b"\n")
        return line.decode()

    def close(self) -> None:
        """Ends the process."""
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()


class Command:
    """A command under way."""

    def __init__(self, nursery: Nursery, pid: int, folder: Path) -> None:
        self._nursery, self.pid, self._folder = nursery, pid, folder
        self.code: int | None = None

    def poll(self, seconds: float = 0.0) -> int | None:
        """Its exit code, that of a signal negative; None while it runs on after so many seconds."""
        if self.code is None and (line := self._nursery.line(seconds)) is not None:
            self.code = int(line)
        return self.code

    def wait(self, seconds: float = LONGEST_SECONDS) -> int:
        """Its exit code."""
        code = self.poll(seconds)
        if code is None:
            self.send(signal.SIGKILL)
            raise AssertionError(f"the command still ran after {seconds:g} s: {self.err}")
        return code

    def send(self, number: int) -> None:
        """A signal, if it still runs."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def cpu_seconds(self) -> float:
        """Processor time that it and its own children have used: tells how far it is, however busy the machine is."""
        try:
            return _ticks(self.pid) / os.sysconf("SC_CLK_TCK")
        except (OSError, ValueError, IndexError):  # it has just ended
            return 0.0

    @property
    def out(self) -> str:
        """What it has written to stdout."""
        return (self._folder / "out").read_text()

    @property
    def err(self) -> str:
        """What it has written to stderr."""
        return (self._folder / "err").read_text()


def _ticks(pid: int) -> int:
    """utime, stime and those of ended children of a process and of all below it (proc(5))."""
    own = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    below = [one for task in Path(f"/proc/{pid}/task").iterdir() for one in (task / "children").read_text().split()]
    return sum(map(int, own[11:15])) + sum(_ticks(int(child)) for child in below)


def serve() -> None:
    """Reads orders from stdin; answers each with the child's number, and, when it has ended, its exit code."""
    import stages.deform_init
    import stages.evaluate  # all of them: what the children find imported
    import stages.nerf_fit
    import stages.pose_import
    import stages.render
    import stages.stylize  # noqa: F401

    for line in sys.stdin:
        child = os.fork()
        if child == 0:
            sys.exit(_obey(json.loads(line)))  # through the interpreter's end, as a command does
        print(child, flush=True)
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)


def _obey(order: dict) -> int:
    import resource

    from stylerf_cli.main import main

    for number, name in ((1, "out"), (2, "err")):
        handle = os.open(Path(order["folder"], name), os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
        os.dup2(handle, number)
    os.close(0)
    os.open(os.devnull, os.O_RDONLY)
    for name, value in order["limits"].items():
        resource.setrlimit(getattr(resource, name), (value, value))
    if order["held"]:
        os.kill(os.getpid(), signal.SIGSTOP)
    return main(order["argv"])


if __name__ == "__main__":
    serve()
