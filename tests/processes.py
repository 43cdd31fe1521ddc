"""Starts a command in several processes of this machine, as torchrun would, but for its agent."""

import os
import socket
import subprocess
import sys
import time
from pathlib import Path

REPOSITORY = Path(__file__).parents[1]


def start(count: int, *command: str, folder: Path) -> list[subprocess.Popen]:
    """`python -m COMMAND` in `count` processes of one thread each; folder: where out<place> and err<place> are kept."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    made = []
    for place in range(count):
        ranks = {"RANK": str(place), "LOCAL_RANK": str(place), "WORLD_SIZE": str(count), "LOCAL_WORLD_SIZE": str(count),
                "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port, "NUMBA_NUM_THREADS": "1"}  # fmt: skip
        with open(folder / f"out{place}", "wb") as out, open(folder / f"err{place}", "wb") as err:
            line = [sys.executable, "-m", *command]
            made.append(subprocess.Popen(line, cwd=REPOSITORY, env=os.environ | ranks, stdout=out, stderr=err))
    return made


def ended(processes: list[subprocess.Popen], seconds: float) -> list[int]:
    """Their exit codes. Those that wait for each other for longer are killed: a fault to tell, not to sit out."""
    end = time.monotonic() + seconds
    try:
        return [process.wait(max(0.1, end - time.monotonic())) for process in processes]
    finally:
        for process in processes:
            process.kill()
