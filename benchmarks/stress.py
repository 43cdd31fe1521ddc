"""Methods under faults, without and with remedies: `python -m benchmarks.stress OUT.json WORK... [OPTIONS]`.

Each WORK is a folder with a scene; runs are kept in WORK/stress, and finished runs are not repeated. Other options are
passed on to `stylerf stress`: --methods, --faults, --quick, --budget, --style-budget, --side, --seeds.

Protocol: `stylerf stress` in one work folder after another, with the remedies given in the command; faults of synthetic
scenes, which are the same for every WORK, only in the first. Only training views have the fault, never test views. A
fit succeeds if it is finite and 3 dB closer to the test photos than a flat color (for an object: than its silhouettes
in one color); a stylization if it is finite, keeps a third of the photos' structure (the local variance of luma
explained by a linear fit to the render's luma; for an object, beyond its silhouettes) and is at most 0.7 times as far
from the painting's colors; a local edit if it is finite, changes its region by 10 dE and its surroundings by at most a
fifth of that, and keeps a luma SSIM of 0.2 with the original field. Figures: PSNR (dB) of fits, structure kept of
stylizations, and for edits the fraction of the change that stays inside; medians over seeds.
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
    """Return the options known here and all other flags, for `stylerf stress`; flags start at the first `--`."""
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
    """Return the names of faults; those of synthetic scenes only for the first work folder."""
    from stages.configs.faults import FAULTS, MADE

    chosen = [name for name in FAULTS if name in requested or "all" in requested]
    return [name for name in chosen if first or FAULTS[name].of != MADE]


def rows_of(work: Path, faults: list[str], flags: list[str], remedies: str) -> tuple[list[dict], dict]:
    """Return one row per cell, and what was left out with the common conditions."""
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
