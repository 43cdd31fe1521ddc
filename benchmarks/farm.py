"""Fault injection (kills) and a simulated cluster, on a table of small jobs.

    python -m benchmarks.farm kills OUT.json [--scenes 5] [--seed 0]
    python -m benchmarks.farm slurm OUT.json [--scenes 2] [--seed 0]

Protocol of `kills`: a table of tiny captures (48x36, 4 photos, budgets in steps, one thread per job) with one
nonexistent scene is run undisturbed. It is then run in a second folder, where a third of all attempts are killed by
SIGKILL at a random fraction of their verb's median time, and where `stylerf farm` itself is killed twice, including
Snakemake, and restarted; while it runs, the same command is started a second time and must be refused. At the end, the
digests of all files of all artifacts (for evaluations: the figures) must equal those of the undisturbed run, nothing
may be left of interrupted runs, `stylerf verify` must find every work folder intact, and only the nonexistent scene may
be reported. Jobs are children of a server that has imported stylerf and loaded its kernels, so that a job takes
seconds.

Protocol of `slurm`: such a table is run undisturbed on this machine, then with --profile slurm, where sbatch, sacct,
scancel and srun are stand-ins (tests/slurm_stand_in.py) that run jobs locally, with delays; 15 % of the jobs are
preempted and requeued, 15 % die with their node, 10 % are reported as lost while they are still running; a tenth of the
status queries fails. At the end, the digests must equal those of the undisturbed run. This simulates the behavior of a
cluster; its figures are not measurements of a cluster.
"""

import argparse
import json
import os
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from random import Random

from benchmarks.conditions import here_and_now
from tests.campaign.ground import contents, leftovers
from tests.farm_table import RENDER, warming, write_table
from tests.job_server import JobServer, Killing
from tests.slurm_stand_in import install, jobs_in

KILLED_SHARE, WHOLE_KILLS, MOST_RUNS = 1 / 3, 2, 10

VERSIONS = {name: version(name) for name in ("snakemake", "snakemake-executor-plugin-slurm", "numba", "torch")}
HERE = ("--cores", "2")


def farm(
    table: Path, server: JobServer, log: Path, flags: Sequence[str] = HERE, env: dict[str, str] | None = None
) -> "subprocess.Popen[bytes]":
    """Start the command; Snakemake's output goes to `log`."""
    with open(log, "ab") as stream:
        return subprocess.Popen(
            [sys.executable, "-m", "stylerf_cli.main", "farm", str(table), "--json", *flags],
            env=os.environ | server.env | (env or {}), stdout=subprocess.PIPE, stderr=stream, start_new_session=True,
        )  # fmt: skip


def small_table(folder: Path, scenes: int, **more: object) -> Path:
    """Write a table of tiny captures, one of which does not exist."""
    table = write_table(folder, scenes, 2, **more)
    content = json.loads(table.read_text())
    content["scenes"]["bad"] = "nowhere"
    table.write_text(json.dumps(content))
    return table


def differing(one: dict[str, dict], other: dict[str, dict]) -> list[str]:
    """Return the artifacts that differ or exist in only one of them."""
    return [f"{scene}/{name}" for scene in one for name in one[scene] | other[scene]
            if one[scene].get(name) != other[scene].get(name)]  # fmt: skip


def left_over(table: Path, scenes: int) -> list[str]:
    """Return partial runs and temporary files in the work folders."""
    return [name for number in range(scenes) for name in leftovers(table.with_suffix("") / f"scene{number}")]


def result_of(command: "subprocess.Popen[bytes]") -> dict:
    """Return the command's JSON and exit code."""
    out, _ = command.communicate()
    return {"code": command.returncode, **(json.loads(out) if out.strip() else {})}


def digests(table: Path, scenes: int) -> dict[str, dict]:
    """Return contents() by scene."""
    return {f"scene{number}": contents(table.with_suffix("") / f"scene{number}") for number in range(scenes)}


def killed_whole(command: "subprocess.Popen[bytes]", after: float) -> bool:
    """Kill the command and Snakemake after `after` seconds; return whether they were still running."""
    try:
        command.wait(after)
        return False
    except subprocess.TimeoutExpired:
        pass
    children = Path(f"/proc/{command.pid}/task/{command.pid}/children").read_text().split()
    for child in children:  # Snakemake has its own process group
        os.killpg(int(child), signal.SIGKILL)
    command.kill()
    command.communicate()
    return True


def kills(scenes: int, seed: int, folder: Path) -> dict:
    """Run the campaign of kills; return what happened."""
    chance, commands = Random(seed), warming(folder / "warming")
    tables = [small_table(folder / name, scenes, seeds=2) for name in ("undisturbed", "killed")]

    server = JobServer(folder / "first", warm=commands)
    start = time.monotonic()
    first = result_of(farm(tables[0], server, folder / "first.log"))
    whole_seconds = time.monotonic() - start
    seconds = defaultdict(list)
    for one in server.children():
        seconds[one["argv"][0]].append(one["seconds"])
    server.close()
    medians = {verb: statistics.median(values) for verb, values in seconds.items()}
    print(f"undisturbed: {first['finished']} jobs in {whole_seconds:.0f} s", flush=True)

    server = JobServer(folder / "second", Killing(KILLED_SHARE, medians, seed), commands)
    start, runs, refused, wholes = time.monotonic(), 0, [], 0
    while True:
        runs += 1
        command = farm(tables[1], server, folder / "second.log")
        if wholes < WHOLE_KILLS:
            time.sleep(20)
            refused.append(result_of(farm(tables[1], server, folder / "third.log")))
            if killed_whole(command, whole_seconds * chance.uniform(0.1, 0.5)):
                wholes += 1
                print(f"killed as a whole, {wholes}", flush=True)
                continue
        last = result_of(command)
        if {one["key"] for one in last["failed"]} == {"bad/scene/main"} or runs == MOST_RUNS:
            break
    killed_seconds = time.monotonic() - start
    children = server.children()
    server.close()
    verified = [
        subprocess.run(
            [sys.executable, "-m", "stylerf_cli.main", "verify", str(tables[1].with_suffix("") / f"scene{number}"),
             "--quiet"], check=False, capture_output=True,
        ).returncode
        for number in range(scenes)
    ]  # fmt: skip
    one, other = (digests(table, scenes) for table in tables)
    ends = Counter(child["code"] for child in children)
    return {
        "jobs": first["jobs"],
        "finished": [first["finished"], last["finished"]],
        "artifacts_compared": sum(map(len, one.values())),
        "differing": differing(one, other),
        "left_over": left_over(tables[1], scenes),
        "verify_exit_codes": verified,
        "failed": [[entry["key"] for entry in end["failed"]] for end in (first, last)],
        "why": last["failed"][0]["why"].replace(str(folder), "FOLDER"),
        "attempts": len(children),
        "attempts_killed": ends[-signal.SIGKILL],
        "exit_codes": {str(code): count for code, count in sorted(ends.items())},
        "whole_runs_killed": wholes,
        "runs": runs,
        "second_run_refused": [[one["code"], one.get("error", "").replace(str(folder), "FOLDER")] for one in refused],
        "seconds": {"undisturbed": round(whole_seconds), "killed": round(killed_seconds)},
        "median_seconds_of_verbs": {verb: round(value, 2) for verb, value in medians.items()},
    }


def slurm(scenes: int, seed: int, folder: Path) -> dict:
    """Run a table on the simulated cluster; return what happened."""
    shape = {"eval": False, "methods": {"arf": {}}, "render": {**RENDER, "shards": 1}}
    tables = [small_table(folder / name, scenes, **shape) for name in ("undisturbed", "cluster")]
    server = JobServer(folder / "server", warm=warming(folder / "warming"))
    first = result_of(farm(tables[0], server, folder / "first.log"))
    start, runs = time.monotonic(), 0
    env = install(folder / "slurm", seed)
    while True:
        runs += 1
        flags = ("--profile", "slurm", "--snakemake=--slurm-init-seconds-before-status-checks 2 "
                 "--seconds-between-status-checks 3 --latency-wait 10")  # fmt: skip
        last = result_of(farm(tables[1], server, folder / "second.log", flags, env))
        named = {one["key"] for one in last.get("failed", ())}
        if last["code"] != 1 or named == {"bad/scene/main"} or runs == MOST_RUNS:
            break
    seconds = time.monotonic() - start
    children = server.children()[-1000:]
    server.close()
    jobs = jobs_in(folder / "slurm")
    one, other = (digests(table, scenes) for table in tables)
    return {
        "jobs": first["jobs"],
        "finished": [first["finished"], last.get("finished")],
        "error": last.get("error", "").replace(str(folder), "FOLDER"),
        "differing": differing(one, other),
        "left_over": left_over(tables[1], scenes),
        "verify_exit_codes": [],
        "failed": [[entry["key"] for entry in end.get("failed", ())] for end in (first, last)],
        "submitted": len(jobs),
        "fates_met": dict(Counter(job["met"] for job in jobs if job.get("met"))),
        "states": dict(Counter(job["state"] for job in jobs)),
        "exit_codes_of_commands": dict(Counter(str(one["code"]) for one in children)),
        "runs": runs,
        "seconds_simulated": round(seconds),
    }


def main() -> int:
    """Run the requested campaign and write its result; return 1 if anything was wrong."""
    parser = argparse.ArgumentParser(prog="benchmarks.farm", description=__doc__.split("\n\n")[0])
    parser.add_argument("what", choices=["kills", "slurm"])
    parser.add_argument("out", type=Path)
    parser.add_argument("--scenes", type=int, default=0, help="0: 5, with slurm 2")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    scenes = asked.scenes or {"kills": 5, "slurm": 2}[asked.what]
    folder = Path(tempfile.mkdtemp(prefix="farm-"))
    try:
        found = {"kills": kills, "slurm": slurm}[asked.what](scenes, asked.seed, folder)
    finally:
        for log in folder.glob("*.log"):
            shutil.copy(log, asked.out.parent / f".{log.name}")
        shutil.rmtree(folder, ignore_errors=True)
    protocol = __doc__.partition(f"Protocol of `{asked.what}`: ")[2].partition("\n\n")[0].strip()
    command = f"python -m benchmarks.farm {asked.what} OUT.json --scenes {scenes} --seed {asked.seed}"
    result = {"command": command, "protocol": protocol, **here_and_now(), "versions": VERSIONS, "seed": asked.seed}
    asked.out.write_text(json.dumps(result | found, indent=1) + "\n")
    wrong = found["differing"] or found["left_over"] or any(found["verify_exit_codes"])
    return int(bool(wrong) or found["finished"][0] != found["finished"][1])


if __name__ == "__main__":
    sys.exit(main())
