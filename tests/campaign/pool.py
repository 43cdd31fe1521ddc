"""Processes that read mutants one by one, and a watchdog that ends those that hang or take too much memory.

A worker has imported stylerf once; it damages a file, runs the command on it by `stylerf_cli.main`, and tells what came
of it. One that dies is replaced: its death is what came of that mutant.
"""

import io
import json
import os
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

from tests.campaign.readers import BY_NAME, Case, Placed, alone, must_be_refused, place
from tests.stylerf_cli.nursery import REPOSITORY, WITHOUT_GPUS

LONGEST_SECONDS = 20.0
GIVEN_UP_SECONDS = 60.0  # a hang is one long before; until then it may only be a busy machine
MOST_BYTES = 2e9
KILLED_BYTES = 6e9
REFUSALS = (2, 3, 4, 5)
FAULTS = ("traceback", "crash", "hang", "slow", "memory", "silent", "words", "outside", "other result")


class Worker:
    """One process, restarted if it dies. root: the bases of all cases. lane: number of its folder."""

    def __init__(self, root: Path, lane: int) -> None:
        self.root, self._lane = root, root.parent / f"lane{lane}"
        self._process: subprocess.Popen | None = None
        self._read = b""

    def run(self, case: str, number: int, seed: int) -> dict[str, Any]:
        """Return the result of that mutant: `outcome` is `read`, `refused` or one of FAULTS."""
        if self._process is None:
            self._begin()
        order = {"case": case, "number": number, "seed": seed}
        self._process.stdin.write(json.dumps(order).encode() + b"\n")
        begun, peak = time.monotonic(), 0
        while (line := self._line(0.2)) is None:
            peak = max(peak, _resident(self._process.pid))
            if time.monotonic() - begun > GIVEN_UP_SECONDS or peak > KILLED_BYTES:
                self._process.kill()
                self._process.wait()
                self._process = None
                outcome = "memory" if peak > KILLED_BYTES else "hang"
                return order | {"outcome": outcome, "seconds": round(time.monotonic() - begun, 1), "bytes": peak}
        if line == b"":
            code = self._process.wait()
            self._process = None
            last = (self._lane / "stderr").read_text(errors="replace").strip().splitlines()[-1:]
            return order | {"outcome": "crash", "line": f"the process ended with {code}: {last}", "bytes": peak}
        return order | json.loads(line)

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.stdin.close()
            self._process.wait()
            self._process = None

    def _begin(self) -> None:
        command = [
            sys.executable,
            "-m",
            "tests.campaign.pool",
            str(self.root),
            str(self._lane),
        ]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=REPOSITORY, bufsize=0,
            env=os.environ | WITHOUT_GPUS,
        )  # fmt: skip
        self._read = b""
        assert self._line(300.0) == b"ready", "a worker of the campaign could not begin"

    def _line(self, seconds: float) -> bytes | None:
        """Return the next line; None on timeout, empty if the process has ended."""
        end = time.monotonic() + seconds
        while b"\n" not in self._read:
            if not select.select([self._process.stdout], [], [], max(0.0, end - time.monotonic()))[0]:
                return None
            data = self._process.stdout.read(65536)
            if not data:
                return b""
            self._read += data
        line, _, self._read = self._read.partition(b"\n")
        return line


def _resident(pid: int) -> int:
    """Return the resident bytes of a process."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, IndexError, ValueError):
        return 0


# -- in the worker -----------------------------------------------------------------------------------------------------


def attempt(root: Path, case: Case, number: int, seed: int, folder: Path, wholes: dict[str, Any]) -> dict[str, Any]:
    """Make the mutant in `folder`, have it read, judge the result."""
    placed = place(root, case, number, seed, folder)
    reported: dict[str, Any] = {"file": placed.file.relative_to(folder).as_posix(), "operators": placed.operators}
    _reset_peak()
    begun = time.monotonic()
    code, out, err = call(alone(case.alone), placed.file) if case.alone else command(placed.command)
    reported |= {"seconds": round(time.monotonic() - begun, 3), "bytes": _peak(), "code": code}
    reported["line"] = (err.splitlines() or [""])[-1][:400].replace(str(folder), "")
    fault = judged(case, placed, code, err, reported, wholes)
    if fault == "silent" and "NOT READABLE" in out:  # as `show` has it of one artifact of many
        return reported | {"outcome": "refused"}
    if fault == "words":
        reported["line"] = repr(err[:800])
    return reported | {"outcome": fault or ("read" if code == 0 else "refused")}


def command(words: tuple[str, ...]) -> tuple[int | None, str, str]:
    """Return exit code, stdout and stderr of a command; no code if it let an exception through."""
    from stylerf_cli.main import main

    out, err = io.StringIO(), io.StringIO()
    try:
        with redirect_stderr(err), redirect_stdout(out):
            return main(list(words)), out.getvalue(), err.getvalue()
    except BaseException as error:
        return None, "", f"{type(error).__name__}: {error}"


def call(reader, path: Path) -> tuple[int | None, str, str]:
    """Return the same for a reader that is called."""
    from schemas.safe_names import printable
    from stylerf_cli.exit_codes import code_and_line

    try:
        reader(path)
    except Exception as error:
        code, line = code_and_line(error, [], None)
        return code, "", f"stylerf: error: {printable(line)}\n"
    return 0, "", ""


def judged(case: Case, placed: Placed, code: int | None, err: str, reported: dict[str, Any], wholes: dict) -> str:
    """Return the fault of an outcome, one of FAULTS; empty if it is acceptable."""
    if any(path.name not in ("src", placed.folder.name) for path in placed.folder.parent.iterdir()):
        return "outside"
    if code is None or "Traceback" in err or (code == 1 and "unexpected" in err):
        return "traceback"
    if reported["bytes"] > MOST_BYTES:
        return "memory"
    if reported["seconds"] > LONGEST_SECONDS:
        return "slow"
    if code == 0:
        if why := must_be_refused(case, placed):
            reported["line"] = why
            return "silent"
        if case.same and _files(placed.folder / "work", case.same) != wholes.get(case.same):
            return "other result"
        return "words" if "error" in err else ""
    if code not in (*REFUSALS, 1) or err.count("\n") != 1 or not err.startswith("stylerf: error: "):
        return "words"
    return "words" if any(ord(one) < 32 or one in "\x7f\x9b" for one in err[:-1]) else ""


def _files(work: Path, artifact: str) -> dict[str, str]:
    """Return the digests of an artifact's files."""
    from schemas.work_folder import Artifact

    return {record.path: record.sha256 for record in Artifact(work / artifact).manifest.files}


def _reset_peak() -> None:
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        pass


def _peak() -> int:
    """Return the peak bytes of memory since _reset_peak, or since the start if the system has no reset."""
    import re

    found = re.search(r"^VmHWM:\s*(\d+) kB", Path("/proc/self/status").read_text(), re.MULTILINE)
    return int(found[1]) * 1024 if found else 0


def serve(root: Path, lane: Path) -> None:
    """Read orders from stdin and answer each with a line."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    import stages.nerf_fit
    import stages.pose_import
    import stages.render  # noqa: F401
    from stages.pipeline import resources

    resources._may_have_gpu = lambda: False
    tempfile.tempdir = str(lane / "tmp")  # where reports of crashes go
    shutil.rmtree(lane, ignore_errors=True)
    (lane / "tmp").mkdir(parents=True)
    os.dup2(os.open(lane / "stderr", os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644), 2)
    wholes: dict[str, Any] = {}
    print("ready", file=answers, flush=True)
    for line in sys.stdin:
        order = json.loads(line)
        case = BY_NAME[order["case"]]
        if case.same and case.same not in wholes:
            wholes[case.same] = undisturbed(root, case, lane / "trial" / "t")
        folder = lane / "trial" / "t"
        shutil.rmtree(folder.parent, ignore_errors=True)
        folder.parent.mkdir()
        reported = attempt(root, case, order["number"], order["seed"], folder, wholes)
        print(json.dumps(reported), file=answers, flush=True)


def undisturbed(root: Path, case: Case, folder: Path) -> dict[str, str]:
    """Return what the case's command makes of its undamaged base, in this process, as rounding may differ in others."""
    from tests.campaign.readers import BOUNDED

    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(root / case.base, folder)
    shutil.rmtree(folder / "work" / "field")
    words = (str(folder / one) if one == "work" else str(one) for one in case.commands[0])
    code, _, err = command((*words, *BOUNDED))
    assert code == 0, err
    return _files(folder / "work", case.same)


# -- what came of them -------------------------------------------------------------------------------------------------


def summary(outcomes: list[dict[str, Any]]) -> dict[str, Any]:
    """Return counts by reader and outcome, the largest seconds and bytes, and every fault with how to reproduce it."""
    by_case: dict[str, Counter] = {}
    for one in outcomes:
        by_case.setdefault(one["case"], Counter())[one["outcome"]] += 1
    total = Counter(one["outcome"] for one in outcomes)
    return {
        "mutants": len(outcomes),
        "read": total["read"],
        "refused": total["refused"],
        "tracebacks": total["traceback"],
        "crashes": total["crash"],
        "over_20_s": total["hang"] + total["slow"],
        "over_2_gb": total["memory"],
        "silent_successes": total["silent"] + total["other result"],
        "other_faults": total["words"] + total["outside"],
        "longest_seconds": max((one.get("seconds", 0.0) for one in outcomes), default=0.0),
        "most_mb": round(max((one.get("bytes", 0) for one in outcomes), default=0) / 1e6),
        "by_reader": {case: dict(sorted(counts.items())) for case, counts in sorted(by_case.items())},
        "faults": [one for one in outcomes if one["outcome"] in FAULTS],
    }


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    serve(Path(sys.argv[1]), Path(sys.argv[2]))
