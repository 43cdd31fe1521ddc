"""`python -m tests.campaign OUT.json [--kills 200] [--mutants 10000] [--faults 300] [--crowds 30] [--seed 0]`.

Every fault is printed as it is found. `--only PART` runs one part, `--cases NAME...` some readers, `--stages NAME...`
some stages, `--replay CASE:NUMBER` one mutant, whose folder is kept.
"""

import argparse
import json
import os
import queue
import shlex
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from random import Random
from typing import Any

from tests.campaign import crowds, faults, kills, pool, readers, report
from tests.campaign.ground import Ground, machine_of_strace, prepared
from tests.stylerf_cli.nursery import Nursery

LANES = 2
IN_THE_CLI = 300
UNPRIVILEGED = ("setpriv", "--bounding-set=-dac_override,-dac_read_search", "--inh-caps=-dac_override,-dac_read_search")


def main(argv: list[str] | None = None) -> int:
    """Run the requested parts; return 1 if any fault was found."""
    argv = sys.argv[1:] if argv is None else argv
    requested = arguments(argv)
    place = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    folder = Path(tempfile.mkdtemp(prefix="campaign-", dir=place))
    try:
        with Lanes(folder) as lanes:
            return campaign(requested, lanes, folder, f"python -m tests.campaign {shlex.join(argv)}")
    finally:
        if requested.replay:
            print(f"kept: {folder}")
        else:
            shutil.rmtree(folder, ignore_errors=True)


def arguments(argv: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="tests.campaign", description=__doc__.split("\n\n")[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--mutants", type=int, default=10_000)
    parser.add_argument("--faults", type=int, default=300)
    parser.add_argument("--crowds", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=("kills", "mutants", "faults", "crowds"))
    parser.add_argument("--cases", nargs="+", choices=list(readers.BY_NAME), metavar="NAME")
    parser.add_argument("--stages", nargs="+", metavar="NAME")
    parser.add_argument("--replay", metavar="CASE:NUMBER")
    return parser.parse_args(argv)


class Lanes:
    """Workers side by side; each job goes to whichever is free."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.nurseries: list[Nursery] = []

    def __enter__(self) -> "Lanes":
        self.more(LANES)
        return self

    def more(self, count: int) -> list[Nursery]:
        """Create `count` nurseries."""
        while len(self.nurseries) < count:
            self.nurseries.append(Nursery())
        return self.nurseries[:count]

    def each(self, jobs: Iterable[Any], work: Callable[[int, Any], dict[str, Any]], what: str) -> list[dict[str, Any]]:
        """Return work(lane, job) of every job; print faults as they come."""
        waiting: queue.Queue = queue.Queue()
        for job in jobs:
            waiting.put(job)
        total, results, broken = waiting.qsize(), [], []

        def loop(lane: int) -> None:
            while not broken:
                try:
                    job = waiting.get_nowait()
                except queue.Empty:
                    return
                try:
                    reported = work(lane, job)
                except BaseException as error:
                    broken.append(error)
                    raise
                results.append(reported)
                if reported.get("fault") or reported.get("outcome") in pool.FAULTS:
                    print(f"FAULT {what}: {json.dumps(reported, ensure_ascii=False)[:900]}", flush=True)
                if len(results) % max(total // 20, 1) == 0:
                    print(f"{what}: {len(results)} of {total}", flush=True)

        threads = [threading.Thread(target=loop, args=(lane,)) for lane in range(LANES)]
        for one in threads:
            one.start()
        for one in threads:
            one.join()
        if broken:
            raise broken[0]
        return results

    def __exit__(self, *_) -> None:
        for one in self.nurseries:
            one.close()


def campaign(requested: argparse.Namespace, lanes: Lanes, folder: Path, command: str) -> int:
    """Run all parts in turn; rewrite the result file after each."""
    strace = machine_of_strace()
    if not strace:
        print("strace is missing or may not inject: kills at system calls and failing calls are left out")
    parts: dict[str, Any] = {}
    seconds: dict[str, float] = {}
    begun = time.monotonic()
    ground = prepared(folder, lanes.nurseries[0], requested.stages or (), readers.plain(requested.cases or ()))
    seconds["preparation"] = time.monotonic() - begun
    wholes: dict[str, kills.Undisturbed] = {}

    def known() -> dict[str, kills.Undisturbed]:
        if not wholes:
            lanes.each(ground.stages, undisturbed, "undisturbed")
        return wholes

    def undisturbed(lane: int, name: str) -> dict[str, Any]:
        wholes[name] = kills.undisturbed(lanes.nurseries[lane], ground, ground.stages[name], strace)
        return {}

    wanted = [requested.only] if requested.only else ["kills", "faults", "crowds", "mutants"]
    if requested.replay:
        return replay(requested, ground, lanes)
    for name in wanted:
        begun = time.monotonic()
        if name == "kills":
            parts[name] = killed(requested, ground, lanes, known())
        elif name == "faults":
            parts[name] = failing(requested, ground, lanes, known())
        elif name == "crowds":
            nurseries = lanes.more(crowds.MOST)
            seeds = [f"{requested.seed}/crowd/{number}" for number in range(requested.crowds)]
            found = [
                printed_if_faulty(crowds.trial(nurseries, ground, seed, alike=number % 3 == 0), "crowds")
                for number, seed in enumerate(seeds)
            ]
            parts[name] = crowds.summary(found)
        else:
            parts[name] = damaged(requested, ground, lanes)
        seconds[name] = time.monotonic() - begun
        print(report.line_of(name, parts[name]), flush=True)
        report.write(requested.out, command, requested.seed, parts, seconds, strace)
    return int(any(part["faults"] for part in parts.values()))


def printed_if_faulty(reported: dict[str, Any], what: str) -> dict[str, Any]:
    """Print a fault."""
    if reported["fault"]:
        print(f"FAULT {what}: {json.dumps(reported, ensure_ascii=False)[:900]}", flush=True)
    return reported


def killed(requested: argparse.Namespace, ground: Ground, lanes: Lanes, wholes: dict) -> dict[str, Any]:
    """Run trials until the number of kills is reached, cycling through the stages."""
    names, trials, number = list(ground.stages), [], 0
    while (left := requested.kills - sum(one["kills"] for one in trials)) > 0:
        jobs = [(names[at % len(names)], at) for at in range(number, number + max(left * 2 // 3, 1))]
        number += len(jobs)

        def one(lane: int, job: tuple[str, int]) -> dict[str, Any]:
            name, at = job
            stage, by_call = ground.stages[name], (at // len(names)) % 2 == 1 and bool(wholes[name].calls)
            seed = f"{requested.seed}/{name}/{at}"
            return kills.trial(lanes.nurseries[lane], ground, stage, wholes[name], seed, by_call) | {"by_call": by_call}

        trials += lanes.each(jobs, one, "kills")
        if number > 20 * requested.kills:
            break
    return kills.summary(trials)


def failing(requested: argparse.Namespace, ground: Ground, lanes: Lanes, wholes: dict) -> dict[str, Any]:
    """Inject faults of every kind into every stage in turn, in unprivileged processes where root would not notice."""
    chance = Random(f"{requested.seed}/faults")
    kinds = [
        kind
        for kind in faults.KINDS
        if (kind in (faults.MOUNTED, faults.CLOSED) or any(one.calls for one in wholes.values()))
        and (kind != faults.CLOSED or shutil.which("setpriv") or os.geteuid() != 0)
    ]
    jobs = [(kinds[at % len(kinds)], chance.choice(list(ground.stages)), at) for at in range(requested.faults)]
    prefix = UNPRIVILEGED if os.geteuid() == 0 else ()
    weak = [Nursery(prefix) for _ in range(LANES)] if faults.CLOSED in kinds else []

    def one(lane: int, job: tuple[str, str, int]) -> dict[str, Any]:
        kind, name, at = job
        nursery = weak[lane] if kind == faults.CLOSED else lanes.nurseries[lane]
        return faults.trial(
            nursery, ground, ground.stages[name], wholes[name], kind, f"{requested.seed}/{kind}/{name}/{at}"
        )

    try:
        return faults.summary(lanes.each(jobs, one, "faults"))
    finally:
        for nursery in weak:
            nursery.close()


def damaged(requested: argparse.Namespace, ground: Ground, lanes: Lanes) -> dict[str, Any]:
    """Read mutants in workers; read a sample by separate commands too, whose exit codes must agree."""
    root = readers.prepare(ground, lanes.nurseries[0], requested.cases or ())
    workers = [pool.Worker(root, lane) for lane in range(LANES)]
    try:

        def read(lane: int, job: tuple[str, int]) -> dict[str, Any]:
            return workers[lane].run(job[0], job[1], requested.seed)

        sound = lanes.each(readers.sound(requested.cases or ()), read, "sound files")
        refused = [one for one in sound if one["outcome"] != "read"]
        assert not refused, f"what is not damaged is not read: {refused}"
        jobs = readers.numbers(requested.mutants, requested.cases or ())
        outcomes = lanes.each(jobs, read, "mutants")
    finally:
        for one in workers:
            one.close()
    reported = [one for one in outcomes if readers.BY_NAME[one["case"]].commands and one.get("code") is not None]
    reported = Random(requested.seed).sample(reported, min(len(reported), IN_THE_CLI * requested.mutants // 10_000))
    again = lanes.each(
        reported, lambda lane, one: in_a_command(lanes.nurseries[lane], root, one, lane), "mutants in commands"
    )
    whole = pool.summary(outcomes)
    whole["in_commands_of_their_own"] = len(again)
    whole["faults"] += [one for one in again if one["fault"]]
    return whole


def in_a_command(nursery: Nursery, root: Path, reported: dict[str, Any], lane: int) -> dict[str, Any]:
    """Read the same mutant in a separate process."""
    folder = root.parent / f"command{lane}" / "t"
    shutil.rmtree(folder.parent, ignore_errors=True)
    folder.parent.mkdir(parents=True)
    placed = readers.place(root, readers.BY_NAME[reported["case"]], reported["number"], reported["seed"], folder)
    ended = nursery.run(root.parent / f"said{lane}", *placed.command)
    fault = ""
    if ended.code != reported["code"]:
        fault = (
            f"ends with {ended.code} in a command of its own, with {reported['code']} in a worker: {ended.err[:500]}"
        )
    elif ended.code and (ended.err.count("\n") != 1 or not ended.err.startswith("stylerf: error: ")):
        fault = f"more or other than one line: {ended.err[:500]}"
    return {key: reported[key] for key in ("case", "number", "seed")} | {"fault": fault}


def replay(requested: argparse.Namespace, ground: Ground, lanes: Lanes) -> int:
    """Make one mutant, in a folder that is kept."""
    name, _, number = requested.replay.rpartition(":")
    root = readers.prepare(ground, lanes.nurseries[0], [name])
    worker = pool.Worker(root, 0)
    reported = worker.run(name, int(number), requested.seed)
    worker.close()
    print(json.dumps(reported, indent=1, ensure_ascii=False))
    placed = readers.place(root, readers.BY_NAME[name], int(number), requested.seed, root.parent / "replayed")
    print(f"{placed.file}\nstylerf {shlex.join(placed.command)}")
    return int(reported["outcome"] in pool.FAULTS)


if __name__ == "__main__":
    sys.exit(main())
