"""Accuracy against time, memory and parameters: `python -m benchmarks.pareto DATA STYLES OUT.json [OPTIONS]`.

DATA holds the scenes, STYLES the paintings. With $STYLERF_BENCH_WORK, the work folders are kept there and finished runs
are not repeated. Options, each a comma-separated list: --scenes fern,fox,lego --capacities grow,fixed:128x8x16
--budgets 60s,300s --stylized grow --methods arf,desrf --rays auto,dilated --style-budgets 60s; --painting FILE; and
--flags METHOD=FLAGS for further flags of a method. A failed run is kept as a row with the reason.

Protocol: every scene is fitted at each capacity and budget; for each capacity (or those of --stylized), the fit with
the longest budget is stylized by each method with each choice of rays (arf and desrf) and each style budget; all are
evaluated on the held-out views, stylized ones also along a path of 30 frames with all three consistency protocols.
`stylerf compare` then reads the work folders: costs from the manifests, for stylizations the seconds since the fitted
field. One seed, one run at a time.
"""

import argparse
import json
import os
import shlex
import subprocess
import sys
import tempfile
from itertools import product
from pathlib import Path

from benchmarks.conditions import here_and_now
from benchmarks.fits import SCENES as SIZES

SCENES = {name.split()[0]: flags for name, flags in SIZES.items() if name != "lego 400x400"}
PATHS = {"lego": "orbit"}  # around an object; captures: spiral
BY_RAYS = ("arf", "desrf")  # other methods train fields on whole images
KEPT = ("family", "group", "work", "name", "method", "settings", "stages", "costs", "fronts")


class Failed(Exception):
    """A command failed; holds its one-line message."""


def stylerf(*arguments: str) -> dict:
    """Run one command; return its --json object, or raise Failed with its error message."""
    command = [sys.executable, "-m", "stylerf_cli.main", *arguments, "--json"]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    try:
        result = json.loads(done.stdout)
    except json.JSONDecodeError:
        raise Failed(f"exit code {done.returncode}: {done.stderr.strip()[-300:]}") from None
    if done.returncode:
        raise Failed(result.get("error", f"exit code {done.returncode}"))
    return result


def options_of(argv: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="benchmarks.pareto", description=__doc__.split("\n\n")[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("styles", type=Path)
    parser.add_argument("out", type=Path)
    for name, default in (
        ("scenes", "fern,fox,lego"), ("capacities", "grow,fixed:96x8x16,fixed:192x16x24"), ("budgets", "60s,300s"),
        ("methods", "arf,desrf"), ("rays", "auto,full,dilated"), ("style-budgets", "60s"),
    ):  # fmt: skip
        parser.add_argument(f"--{name}", type=lambda text: text.split(","), default=default.split(","))
    parser.add_argument("--stylized", type=lambda text: text.split(","))
    parser.add_argument("--painting", default="starry_night.jpg")
    parser.add_argument("--flags", metavar="METHOD=FLAGS", action="append", default=[])
    requested = parser.parse_args(argv)
    requested.stylized = requested.stylized or requested.capacities
    requested.flags = {name: shlex.split(flags) for name, _, flags in (one.partition("=") for one in requested.flags)}
    return requested


def label(*parts: str) -> str:
    """Return a valid artifact name."""
    return "-".join(parts).replace(":", "").replace(",", "-")


def measure(requested: argparse.Namespace, scene: str, work: str) -> list[dict]:
    """Run everything for a scene in `work`; return the failures."""
    folder, flags = SCENES[scene]
    failed = []

    def made(name: str, *commands: tuple[str, ...]) -> None:
        try:
            for command in commands:
                stylerf(*command)
        except Failed as error:
            failed.append({"scene": scene, "name": name, "failed": str(error)})
            print(f"{scene} {name}: {error}", flush=True)
            return
        print(f"{scene} {name}: done", flush=True)

    stylerf("import", str(requested.data / folder), work, *flags)
    for capacity, budget in product(requested.capacities, requested.budgets):
        name = label("fit", capacity, budget)
        fit = ("fit", work, "--capacity", capacity, "--budget", budget, "--no-buffers", "--name", name)
        made(name, fit, ("eval", work, "--of", name))
    painting = str(requested.styles / requested.painting)
    wanted = [
        (method, rays) for method in requested.methods for rays in (requested.rays if method in BY_RAYS else ["auto"])
    ]
    for capacity, (method, rays), budget in product(requested.stylized, wanted, requested.style_budgets):
        base, name = label("fit", capacity, requested.budgets[-1]), label(method, rays, budget, "of", capacity)
        style = ("stylize", work, "--of", base, "--style", painting, "--method", method, "--budget", budget)
        style += ("--name", name, *(("--rays", rays) if method in BY_RAYS else ()), *requested.flags.get(method, ()))
        look = ("eval", work, "--of", name, "--path", PATHS.get(scene, "spiral"), "--consistency", "all")
        made(name, style, look)
    return failed


def rows_of(works: list[str], out: str) -> list[dict]:
    """Return one row per run, from the work folders."""
    result = stylerf("compare", *works, "--out", out)
    means = [{key: round(one["mean"], 6) for key, one in run["metrics"].items()} for run in result["runs"]]
    return [{key: run[key] for key in KEPT} | {"figures": found} for run, found in zip(result["runs"], means)]


def main(argv: list[str] | None = None) -> None:
    given = sys.argv[1:] if argv is None else argv
    requested = options_of(given)
    works, failed = [], []
    with tempfile.TemporaryDirectory() as scratch:
        kept = Path(os.environ.get("STYLERF_BENCH_WORK", scratch))
        for scene in requested.scenes:
            works.append(str(kept / scene))
            failed += measure(requested, scene, works[-1])
            report = {
                "command": f"python -m benchmarks.pareto DATA STYLES OUT.json {shlex.join(given[3:])}".strip(),
                "protocol": __doc__.split("Protocol: ")[1], "painting": requested.painting,
                **here_and_now(), "rows": rows_of(works, str(kept / "comparison")),
                "failed": failed,
            }  # fmt: skip
            requested.out.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
