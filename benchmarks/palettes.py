"""Recolor a region with LAENeRF and with PaletteNeRF: `python -m benchmarks.palettes FITTED OUT.json [CASES]`.

FITTED holds a work folder per scene, fitted for 60 s, as for benchmarks.edits; each is copied.

Protocol: a region is selected and recolored by `stylerf edit` (LAENeRF). `stylerf stylize --method palettenerf` with
60 s decomposes the same field once, then its whole palette is set to the same color, everywhere and within a reach
around the region's first pixel. All three are evaluated by `stylerf eval --region` on the held-out views: background
MSE against the photos, divided by that of the original field (ratio), change inside the region, bleeding next to it.
The sparsity L_sp is over the region's pixels for LAENeRF, and over all pixels that show the scene for PaletteNeRF.
Seconds are from the stages' manifests, excluding selection. One seed.
"""

import json
import os
import shutil
import sys
import tempfile
from pathlib import Path

from benchmarks.conditions import here_and_now
from benchmarks.edits import HEAD, SHOVEL, stylerf

# name: (work folder, selection flags, palette, reach in scene units)
CASES = {
    "lego shovel": ("lego-400x400", SHOVEL, "all=#2050d0", "0.38"),
    "fox head": ("fox-270x480", HEAD, "all=#2050d0", "0.3"),
}
WANTED = ("background_mse", "background_ratio", "change_inside", "change_lab", "bleeding")


def seconds_of(work: Path, *artifacts: str) -> float:
    """Return the total seconds of the stages that made these artifacts (kind/name)."""
    return sum(json.loads((work / one / "manifest.json").read_text())["seconds"] for one in artifacts)


def row(case: str, method: str, seconds: float, figures: dict, more: dict) -> dict:
    """Return the row of one recolored field."""
    found = {key: round(figures[key], 6) for key in WANTED if key in figures}
    return {"case": case, "method": method, "seconds": round(seconds, 1), **found, **more}


def measure(fitted: Path, case: str, kept: Path) -> list[dict]:
    """Return one row per method."""
    folder, selection, palette, reach = CASES[case]
    work, region = kept / folder, case.replace(" ", "-")
    if not (work / "scene").exists():
        shutil.copytree(fitted / folder / "scene", work / "scene")
        shutil.copytree(fitted / folder / "field" / "fit-60s", work / "field" / "fit-60s")
    made = stylerf("edit", str(work), *selection, "--recolor", "--palette", palette, "--name", region)
    learned = json.loads((work / "edit" / f"{region}-learned" / "manifest.json").read_text())
    seconds = sum(made["seconds"].values()) - made["seconds"]["region"] + learned["seconds"]
    described = {key: learned["figures"][key] for key in ("colors", "sparsity", "palette_variation")}
    figures = stylerf("eval", str(work), "--of", region, "--region", region)["figures"]
    rows = [row(case, "laenerf", seconds, figures, described)]
    method = ("stylize", str(work), "--method", "palettenerf")
    stylerf(*method, "--of", "fit-60s", "--budget", "60s", "--name", "palette")
    learned = json.loads((work / "field" / "palette" / "manifest.json").read_text())
    described = {key: learned["figures"][key] for key in ("colors", "sparsity", "palette_variation")}
    for words, flags in (("everywhere", ()), ("within reach", (*selection[:2], "--reach", reach))):
        name = f"palette-{words.split()[0]}"
        stylerf(*method, "--of", "palette", "--palette", palette, *flags, "--name", name)
        figures = stylerf("eval", str(work), "--of", name, "--region", region)["figures"]
        seconds = seconds_of(work, "field/palette", f"field/{name}")
        rows.append(row(case, f"palettenerf, {words}", seconds, figures, described))
    return rows


def main() -> None:
    fitted, out = Path(sys.argv[1]), Path(sys.argv[2])
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        kept = Path(os.environ.get("STYLERF_BENCH_WORK", scratch))
        for case in sys.argv[3:] or CASES:
            rows += measure(fitted, case, kept)
            print(*rows[-3:], sep="\n", flush=True)
            report = {
                "command": "python -m benchmarks.palettes FITTED OUT.json",
                "protocol": __doc__.split("Protocol: ")[1],
                "flags": {name: " ".join([*CASES[name][1], *CASES[name][2:]]) for name in CASES},
                **here_and_now(), "rows": rows,
            }  # fmt: skip
            out.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
