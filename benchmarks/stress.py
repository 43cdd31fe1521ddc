"""Methods under faults, without and with remedies: `python -m benchmarks.stress OUT.json WORK... [OPTIONS]`.

Each WORK is a folder with a scene; runs are kept in WORK/stress, and finished runs are not repeated. What is not
known here goes to `stylerf stress` as it is: --methods, --faults, --quick, --budget, --style-budget, --side, --seeds.

Protocol: `stylerf stress` in one work folder after another, remedies as the command says; faults of made scenes,
which are the same for every WORK, in the first alone. Training views carry the fault, test views never do. A fit
succeeds where it is finite and 3 dB nearer to the test photos than one flat color (of an object: than its outlines in
one color); a stylization where it is finite, keeps a third of the photos' structure (of the local variance of luma
what a straight line from the render's luma explains, of an object beyond its outlines) and is at most 0.7 times as far
from the painting's colors; a local edit where it is finite, changes its part by 10 dE and what is around it by at most
a fifth of that, and keeps an SSIM of luma of 0.2 with the field before. Figures: PSNR (dB) of fits, structure kept of
stylizations, of edits the share of the change that stays inside, medians over the seeds.
"""

import argparse
import json
import shlex
import sys
from pathlib import Path

from benchmarks.conditions import here_and_now
from benchmarks.pareto import stylerf

KEPT = ("method", "fault", "successes", "count", "rate", "median", "spread", "lowest", "seconds", "whys")


def options_of(argv: list[str]) -> tuple[argparse.Namespace, list[str]]:
    """What is known here, and the flags for `stylerf stress`: all from the first on that begins with two dashes."""
    places = next((i for i, one in enumerate(argv) if one.startswith("--")), len(argv))
    parser = argparse.ArgumentParser(prog="benchmarks.stress", description=__doc__.split("\n\n")[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("works", type=Path, nargs="+", metavar="WORK")
    requested = parser.parse_args(argv[:places])
    parser = argparse.ArgumentParser(prog="benchmarks.stress", allow_abbrev=False)
    parser.add_argument("--faults", nargs="+", default=["all"])
    parser.add_argument("--remedies", choices=("off", "on", "both"), default="both")
    return parser.parse_known_args(argv[places:], requested)


def faults_of(requested: list[str], first: bool) -> list[str]:
    """Names; those of made scenes in the first work folder alone."""
    from stages.configs.faults import FAULTS, MADE

    chosen = [name for name in FAULTS if name in requested or "all" in requested]
    return [name for name in chosen if first or FAULTS[name].of != MADE]


def rows_of(work: Path, faults: list[str], flags: list[str], remedies: str) -> tuple[list[dict], dict]:
    """A row a cell, and what was left out with the conditions of all."""
    reply = stylerf("stress", str(work), "--faults", *faults, "--remedies", remedies, "--quiet", *flags)
    rows = [{"work": work.name} | {key: cell[key] for key in KEPT} for cell in reply["cells"]]
    missing = [{"work": work.name, **one} for one in reply["missing"]]
    conditions = {key: value for key, value in reply["conditions"].items() if key != "scene"}
    return rows, {"missing": missing, "conditions": conditions}


def main(argv: list[str] | None = None) -> None:
    requested, flags = options_of(sys.argv[1:] if argv is None else argv)
    rows: list[dict] = []
    missing: list[dict] = []
    for number, work in enumerate(requested.works):
        if not (faults := faults_of(requested.faults, number == 0)):
            continue
        found, more = rows_of(work, faults, flags, requested.remedies)
        rows, missing = rows + found, missing + more["missing"]
        flags_used = shlex.join(["--faults", *requested.faults, "--remedies", requested.remedies, *flags])
        report = {
            "command": f"python -m benchmarks.stress OUT.json WORK... {flags_used}",
            "protocol": __doc__.split("Protocol: ")[1],
            **here_and_now(),
            "conditions": more["conditions"],
            "rows": rows,
            "missing": missing,
        }
        requested.out.write_text(json.dumps(report, indent=1) + "\n")
        done, requested_for = (sum(row[key] for row in found) for key in ("successes", "count"))
        print(f"{work.name}: {done} of {requested_for} runs succeed", flush=True)


if __name__ == "__main__":
    main()
