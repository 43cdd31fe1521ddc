"""Commands of `stylerf` for whoever runs many: a server that has the imports forks one child for each.

    STYLERF=tests/job_client.py JOB_SERVER=SOCKET stylerf farm ...

The client passes its arguments, folder and streams, and ends as the child does. With a Killing the server kills some of
the children with SIGKILL, each at a random share of the time that such a verb takes.
"""

import contextlib
import gc
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from random import Random

REPOSITORY = Path(__file__).resolve().parent.parent
CLIENT = REPOSITORY / "tests" / "job_client.py"
STARTS_WITHIN_SECONDS = 300.0
LONGEST_ORDER = 1 << 20  # bytes
# Of numba's threading layers only this one lives on in a child that is forked after kernels have run.
ALONE = {"CUDA_VISIBLE_DEVICES": "", "NUMBA_THREADING_LAYER": "workqueue", **dict.fromkeys(
    ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")}  # fmt: skip


@dataclass(frozen=True)
class Killing:
    """Whom to kill. share: of the attempts. seconds: that a verb takes, by verb. seed: of the choice."""

    share: float
    seconds: dict[str, float]
    seed: int


class JobServer:
    """A running server. Close it when done.

    log: a line of JSON for every child: verb, arguments, seconds, exit code (of a signal negative), seconds after which
    it was killed.
    """

    def __init__(self, folder: Path, killing: Killing | None = None, warm: Sequence[Sequence[str]] = ()) -> None:
        """Start it.

        Args:
            folder: of the log and the socket.
            killing: whom to kill; None for nobody.
            warm: commands that the server runs itself before any other, below `folder`, so that its children find
                kernels and weights loaded.
        """
        folder.mkdir(parents=True, exist_ok=True)
        self.log = folder / "children.jsonl"
        self._socket = folder / "socket"
        order = {"folder": str(folder), "killing": None if killing is None else asdict(killing), "warm": warm}
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.job_server", json.dumps(order)], cwd=REPOSITORY,
            env=os.environ | ALONE, stdin=subprocess.DEVNULL,
        )  # fmt: skip
        end = time.monotonic() + STARTS_WITHIN_SECONDS
        while not self._socket.exists():
            assert self._process.poll() is None and time.monotonic() < end, "the server did not start"
            time.sleep(0.05)

    @property
    def env(self) -> dict[str, str]:
        """What makes `stylerf farm` run its jobs here."""
        return {"STYLERF": str(CLIENT), "JOB_SERVER": str(self._socket)}

    def children(self) -> list[dict]:
        """The log."""
        return [json.loads(line) for line in self.log.read_text().splitlines()] if self.log.exists() else []

    def close(self) -> None:
        """End the server; children that still run end by themselves."""
        self._process.terminate()
        self._process.wait()
        self._socket.unlink(missing_ok=True)


def serve(order: dict) -> None:
    """Accept clients for good."""
    import stages.deform_init
    import stages.evaluate
    import stages.nerf_fit
    import stages.pose_import
    import stages.render
    import stages.stylize  # noqa: F401

    folder = Path(order["folder"])
    if order["warm"]:
        _warm_up(folder / "warm", order["warm"])
    gc.freeze()  # else the first collection in every child copies all that it shares with the server
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listening:
        listening.bind(str(folder / ".socket"))
        listening.listen(64)
        os.rename(folder / ".socket", folder / "socket")
        while True:
            client, _ = listening.accept()
            if os.fork() == 0:
                listening.close()
                signal.signal(signal.SIGCHLD, signal.SIG_DFL)
                _attend(client, folder, order["killing"])
                os._exit(0)
            client.close()


def _warm_up(folder: Path, commands: list[list[str]]) -> None:
    from stylerf_cli.main import main

    folder.mkdir()
    before = os.getcwd()
    os.chdir(folder)
    for argv in commands:
        code = main([*argv, "--quiet", "--threads", "1", "--device", "cpu"])
        assert code == 0, argv
    os.chdir(before)


def _attend(client: socket.socket, folder: Path, killing: dict | None) -> None:
    """Run one command in a child of this process, perhaps kill it, and tell the client how it ended."""
    data, streams, _, _ = socket.recv_fds(client, LONGEST_ORDER, 3)
    wanted = json.loads(data)
    moment = _moment(wanted["argv"], folder, killing)
    start = time.monotonic()
    child = os.fork()
    if child == 0:
        sys.exit(_obey(wanted, streams))
    for one in streams:
        os.close(one)
    client.send(str(child).encode())
    if moment is not None:
        while time.monotonic() - start < moment and not _ended(child):
            time.sleep(0.005)
        with contextlib.suppress(ProcessLookupError):
            os.kill(child, signal.SIGKILL)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    seconds = time.monotonic() - start
    line = {"argv": wanted["argv"], "seconds": round(seconds, 3), "code": code, "killed_after": moment}
    with open(folder / "children.jsonl", "a") as log:
        log.write(json.dumps(line) + "\n")
    with contextlib.suppress(OSError):  # the client was killed
        client.send(str(code).encode())


def _ended(child: int) -> bool:
    return os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None


def _moment(argv: list[str], folder: Path, killing: dict | None) -> float | None:
    """After how many seconds this attempt is killed; None for never."""
    if killing is None:
        return None
    attempts = folder / "attempts"
    attempts.mkdir(exist_ok=True)
    name = "_".join(argv).replace("/", "_")[:200]
    number = sum(one.name.startswith(f"{name}.") for one in attempts.iterdir())
    (attempts / f"{name}.{number}").touch()
    chance = Random(f"{killing['seed']} {number} {argv}")
    if chance.random() >= killing["share"]:
        return None
    return round(chance.random() * killing["seconds"].get(argv[0], 1.0), 3)


def _obey(wanted: dict, streams: list[int]) -> int:
    from stylerf_cli.main import main

    for number, stream in zip((0, 1, 2), streams, strict=True):
        os.dup2(stream, number)
        os.close(stream)
    os.chdir(wanted["folder"])
    signal.signal(signal.SIGINT, signal.default_int_handler)
    return main(wanted["argv"])


if __name__ == "__main__":
    serve(json.loads(sys.argv[1]))
