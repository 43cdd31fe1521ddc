"""A stand-in for Slurm's commands: jobs run on this machine, late, preempted, and on nodes that are lost.

No measurement of a cluster. sbatch, sacct, scancel, squeue, sinfo, sacctmgr and srun are this file under other names;
what they know of a job is a file in $STAND_IN. Its fate is drawn when it is submitted:

    preempted   killed at a random moment, back in the queue, run again
    failed      its node fails: killed, state NODE_FAIL
    lost        the node is lost from sight: state NODE_FAIL, while the job runs on
"""

import contextlib
import fcntl
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from random import Random

COMMANDS = ("sbatch", "sacct", "scancel", "squeue", "sinfo", "sacctmgr", "srun")
NODES, SLOTS = ("n1", "n2", "n3", "n4", "n5", "n6", "n7", "n8"), 2
DELAYS = (0.0, 3.0)  # seconds in the queue
KILLED_WITHIN = 20.0  # seconds
FATES = {"preempted": 0.15, "failed": 0.15, "lost": 0.1}
SACCT_FAILS = 0.1


def install(folder: Path, seed: int) -> dict[str, str]:
    """Create the commands below `folder`; return the environment that finds them."""
    for name in COMMANDS:
        command = folder / "bin" / name
        command.parent.mkdir(parents=True, exist_ok=True)
        command.write_text(f'#!/bin/sh\nexec {sys.executable} -I -S {Path(__file__).resolve()} {name} "$@"\n')
        command.chmod(0o755)
    (folder / "jobs").mkdir()
    path = f"{folder / 'bin'}{os.pathsep}{os.environ['PATH']}"
    return {"PATH": path, "STAND_IN": str(folder), "STAND_IN_SEED": str(seed)}


def jobs_in(folder: Path) -> list[dict]:
    """What is known of every job."""
    return [json.loads(file.read_text()) for file in sorted((folder / "jobs").glob("*.json"))]


def _save(job: dict) -> None:
    place = _folder() / "jobs" / f"{job['id']}.json"
    place.with_suffix(".new").write_text(json.dumps(job))
    place.with_suffix(".new").rename(place)


def _folder() -> Path:
    return Path(os.environ["STAND_IN"])


def _value(argv: list[str], flag: str) -> str:
    for index, word in enumerate(argv):
        if word == flag:
            return argv[index + 1]
        if word.startswith(f"{flag}="):
            return word.partition("=")[2]
    return ""


def sbatch(argv: list[str]) -> None:
    """Submit: draw the fate, print the number, and leave a process behind that runs the job."""
    with open(_folder() / "number", "a+") as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        stream.seek(0)
        number = int(stream.read() or 1000) + 1
        stream.seek(0)
        stream.truncate()
        stream.write(str(number))
    chance = Random(f"{os.environ['STAND_IN_SEED']} {number}")
    draw, fate = chance.random(), ""
    for name, share in FATES.items():
        if 0 <= draw < share:
            fate = name
        draw -= share
    excluded = _value(argv, "--exclude").split(",")
    node = chance.choice([one for one in NODES if one not in excluded] or NODES)
    job = {
        "id": str(number), "name": _value(argv, "--job-name"), "state": "PENDING", "fate": fate, "node": node,
        "wrap": _value(argv, "--wrap"), "folder": _value(argv, "-D") or os.getcwd(), "group": 0, "comment":
        _value(argv, "--comment"), "mem": _value(argv, "--mem"), "minutes": _value(argv, "-t"),
        "log": _value(argv, "--output").replace("%j", str(number)), "runs": 0,
        "delay": chance.uniform(*DELAYS), "moment": chance.uniform(0, KILLED_WITHIN),
    }  # fmt: skip
    _save(job)
    print(number, flush=True)
    if os.fork() == 0:
        os.setsid()
        for stream in (0, 1, 2):
            os.dup2(os.open(os.devnull, os.O_RDWR), stream)
        _live(job)


def _live(job: dict) -> None:
    """The job's life, until its state is final."""
    while True:
        time.sleep(job["delay"])
        with _slot():
            if _canceled(job):
                return
            killed = _run(job)
        if killed != "preempted":
            return
        job["fate"] = ""  # once
        _save(job | {"state": "PENDING", "group": 0})


@contextlib.contextmanager
def _slot():
    """Wait for one of the places of the cluster."""
    while True:
        for place in range(SLOTS):
            with open(_folder() / f"slot{place}", "a") as stream:
                with contextlib.suppress(BlockingIOError):
                    fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    yield
                    return
        time.sleep(0.2)


def _canceled(job: dict) -> bool:
    return json.loads((_folder() / "jobs" / f"{job['id']}.json").read_text())["state"] == "CANCELLED"


def _run(job: dict) -> str:
    """Run the job once; return the fate that met it, or nothing."""
    job["runs"] += 1
    with open(job["log"], "ab") as log:
        child = subprocess.Popen(
            ["sh", "-c", job["wrap"]], cwd=job["folder"], stdin=subprocess.DEVNULL, stdout=log, stderr=log,
            env=os.environ | {"SLURM_JOB_ID": job["id"], "SLURM_JOBID": job["id"]}, start_new_session=True,
        )  # fmt: skip
    _save(job | {"state": "RUNNING", "group": child.pid})
    try:
        code = child.wait(job["moment"] if job["fate"] else None)
    except subprocess.TimeoutExpired:
        if job["fate"] == "lost":
            _save(job | {"state": "NODE_FAIL", "met": "lost"})
            child.wait()
            return "lost"
        os.killpg(child.pid, signal.SIGKILL)
        child.wait()
        if job["fate"] == "failed":
            _save(job | {"state": "NODE_FAIL", "met": "failed"})
        else:
            job["met"] = "preempted"
        return job["fate"]
    if not _canceled(job):
        _save(job | {"state": "COMPLETED" if code == 0 else "FAILED"})
    return ""


def sacct(argv: list[str]) -> None:
    """Number and state of the jobs of a name, or the node of a job; sometimes the database does not answer."""
    if number := _value(argv, "-j"):
        print(next(job["node"] for job in jobs_in(_folder()) if job["id"] == number))
        return
    if Random().random() < SACCT_FAILS:
        sys.exit("sacct: error: slurm_persist_conn_open_without_init: failed to open persistent connection")
    name = _value(argv, "--name")
    for job in jobs_in(_folder()):
        if job["name"] == name:
            print(f"{job['id']}|{job['state']}")


def scancel(argv: list[str]) -> None:
    """End jobs."""
    for number in (word for word in argv if re.fullmatch(r"\d+", word)):
        job = json.loads((_folder() / "jobs" / f"{number}.json").read_text())
        if job["state"] in ("PENDING", "RUNNING"):
            _save(job | {"state": "CANCELLED"})
            if job["group"]:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(job["group"], signal.SIGTERM)


def main(name: str, argv: list[str]) -> None:
    """Be one of the commands."""
    if name == "srun":
        command = argv
        while command and command[0].startswith("-"):
            command = command[1:]
        os.execvp(command[0], command)
    elif name == "sinfo":
        print("PARTITION\ncpu*")
    elif name == "sacctmgr":
        print("lab")
    else:
        {"sbatch": sbatch, "sacct": sacct, "scancel": scancel, "squeue": sacct}[name](argv)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
