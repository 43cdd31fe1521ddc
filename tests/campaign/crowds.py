"""Several processes on one work folder at once: the same command, different ones, and readers among them.

Each must end with 0, or with 5 where another one writes the same artifact. Then every command is run alone: the work
folder must hold the very artifacts that commands one after the other make.
"""

from collections import Counter
from pathlib import Path
from random import Random
from typing import Any

from tests.campaign.ground import FEW, FIT, QUIET, Ground, contents, copy_of, leftovers, verified
from tests.campaign.kills import differing
from tests.stylerf_cli.nursery import Nursery

FEWEST, MOST = 2, 8


# None of them writes what another one reads or writes. The work folder comes after the verb.
COMMANDS: tuple[tuple[object, ...], ...] = (
    ("fit", *FIT, "--seed", "1", "--name", "x"),
    ("fit", *FIT, "--seed", "2", "--name", "y"),
    ("render", "--of", "fit", "--path", "orbit", "--count", "5", "--name", "x"),
    ("render", "--of", "painted", "--path", "orbit", "--count", "4", "--name", "y"),
    ("extract", "--region", "all", "--name", "x"),
    ("stylize", "--region", "all", "--recolor", "--palette", "0=#ff0000", *FEW, "--name", "z"),
    ("distill", "--edit", "gray", "--name", "x"),
    ("finetune", "--edit", "gray", "--budget", "20", "--rays", "512", "--name", "w"),
)
READING = (("show",), ("verify",))


def trial(nurseries: list[Nursery], ground: Ground, seed: str, alike: bool, plain: bool = False) -> dict[str, Any]:
    """Run one crowd; return what happened, with an empty `fault` if all is well. alike: all run the same command.
    plain: the work folder holds a field but no edit."""
    chance = Random(seed)
    count = min(chance.randint(FEWEST, MOST), len(nurseries))
    known = COMMANDS[2:3] if plain else COMMANDS
    chosen = [chance.choice(known)] * count if alike else [chance.choice(known + READING) for _ in range(count)]
    reported: dict[str, Any] = {
        "seed": seed,
        "alike": alike,
        "processes": count,
        "commands": [" ".join(one[:1]) for one in chosen],
    }
    with copy_of(ground.made, ground.folder / "trials") as work:
        running = [
            nursery.start(work.parent / f"said{number}", verb, work, *options, *QUIET)
            for number, (nursery, (verb, *options)) in enumerate(zip(nurseries, chosen))
        ]
        codes = [command.wait() for command in running]
        reported["codes"] = codes
        for command, line in zip(running, chosen):
            if (
                command.code not in (0, 5)
                or "Traceback" in command.err
                or (command.code and command.err.count("\n") != 1)
            ):
                return reported | {"fault": f"{' '.join(map(str, line))} ends with {command.code}: {command.err[:600]}"}
        if fault := verified(nurseries[0], work):
            return reported | {"fault": fault}
        made = contents(work)
        if fault := _run_all(nurseries[0], work, chosen):
            return reported | {"fault": fault}
        crowd, left = contents(work), leftovers(work)
    with copy_of(ground.made, ground.folder / "trials") as work:
        if fault := _run_all(nurseries[0], work, chosen):
            return reported | {"fault": fault}
        alone = contents(work)
    other = differing(crowd, alone) or differing(made, {name: alone.get(name, {}) for name in made})
    if other or left:
        return reported | {"fault": f"makes another or leaves {', '.join([*other, *left][:4])}"}
    return reported | {"fault": ""}


def _run_all(nursery: Nursery, work: Path, chosen: list[tuple]) -> str:
    for verb, *options in sorted(set(chosen), key=chosen.index):
        ended = nursery.run(work.parent / "said", verb, work, *options, *QUIET)
        if ended.code != 0:
            return f"alone, {verb} ends with {ended.code}: {ended.err.strip()}"
    return ""


def summary(trials: list[dict[str, Any]]) -> dict[str, Any]:
    """Return counts by exit code and number of processes, and every fault with its seed."""
    return {
        "crowds": len(trials),
        "processes": sum(one["processes"] for one in trials),
        "by_size": dict(sorted(Counter(str(one["processes"]) for one in trials).items())),
        "by_code": dict(sorted(Counter(str(code) for one in trials for code in one.get("codes", [])).items())),
        "faults": [one for one in trials if one["fault"]],
    }
