"""Records with strace which system calls a command makes on its work folder, and makes one of them fail."""

import os
import re
import select
import signal
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.stylerf_cli.nursery import Command, Nursery

# Newer names first: where one is not known to the machine, strace refuses all of them.
CALLS = ("openat", "write", "writev", "pwrite64", "fsync", "fdatasync", "rename", "renameat2", "unlink", "unlinkat",
         "mkdir", "ftruncate", "fallocate", "read", "lseek", "flock")  # fmt: skip
_LINE = re.compile(r"^(\d+) +(\w+)\((.*)$")
ATTACH_SECONDS = 60.0


@dataclass(frozen=True)
class Call:
    """The `number`-th call (from 1) of that name by the command's main thread. text: its arguments and result."""

    name: str
    number: int
    text: str

    @property
    def writes(self) -> bool:
        """Return whether it changes the disk."""
        if self.name == "openat":
            return "O_CREAT" in self.text
        return self.name not in ("read", "lseek", "flock")


def traced(
    nursery: Nursery,
    said: Path,
    log: Path,
    command: Sequence[object],
    asked: Sequence[str],
    calls: Sequence[str] = CALLS,
) -> tuple[Command, subprocess.Popen]:
    """Start a command under strace. asked: its `-e inject=` expressions."""
    started = nursery.start(said, *command, held=True)
    while started.poll(0.001) is None and "T" != _state(started.pid):
        pass
    tracer = subprocess.Popen(
        ["strace", "-f", "-y", "-s", "0", "-o", str(log), "-e", f"trace={','.join(calls)}", "-e", "signal=none",
         *(word for one in asked for word in ("-e", f"inject={one}")), "-p", str(started.pid)],
        stderr=subprocess.PIPE, env=os.environ | {"LC_ALL": "C"},
    )  # fmt: skip
    said = b""
    while b"attached" not in said:
        ready = select.select([tracer.stderr], [], [], ATTACH_SECONDS)[0]
        more = os.read(tracer.stderr.fileno(), 4096) if ready else b""
        if not more:
            started.send(signal.SIGKILL)
            raise RuntimeError(f"strace did not attach: {said.decode(errors='replace')}")
        said += more
    started.send(signal.SIGCONT)
    return started, tracer


def _state(pid: int) -> str:
    """Return one letter (proc(5)); T if stopped."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (OSError, IndexError):
        return ""


def ended(tracer: subprocess.Popen) -> None:
    """Wait for strace, which ends with the traced process."""
    try:
        tracer.communicate(timeout=30)
    except subprocess.TimeoutExpired:  # a child of the command lives on
        tracer.send_signal(signal.SIGTERM)
        tracer.communicate()


def calls_on(log: Path, pid: int, work: Path) -> list[Call]:
    """Return the main thread's calls on paths in the folder of `work`."""
    counts: dict[str, int] = {}
    found = []
    place = str(work)
    for line in log.read_text(errors="replace").splitlines():
        call = _LINE.match(line)
        if call is None or int(call[1]) != pid:
            continue
        counts[call[2]] = counts.get(call[2], 0) + 1
        if place in call[3]:
            found.append(Call(call[2], counts[call[2]], call[3].replace(place, "")))
    return found


def injected(log: Path, work: Path) -> list[str]:
    """Return the calls that were made to fail, with their paths in the folder of `work`."""
    place = str(work)
    lines = log.read_text(errors="replace").splitlines() if log.exists() else []
    return [line.replace(place, "") for line in lines if "(INJECTED)" in line]
