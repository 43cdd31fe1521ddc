"""Local edits of real scenes: `python -m benchmarks.edits FITTED OUT.json STYLES [CASES]`.

FITTED holds a work folder per scene, fitted for 60 s (kept by `python -m benchmarks.fits` with $STYLERF_BENCH_WORK);
each is copied and not modified. STYLES holds the paintings.

Protocol: `stylerf edit` with the flags below, one after another, then `stylerf eval --of EDIT --region EDIT` on the
held-out views. Seconds are from the stages' manifests, with selection listed separately, since a user looks at previews
in between. Background: pixels that are at most half inside the region as shown by the unedited field, excluding two
pixels around it; compared with the photos. One seed.
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.conditions import here_and_now

HEAD = ["--at", "0021:101,129"]
SHOVEL = ["--at", "r_10:300,90", "--at", "r_10:244,100", "--neck", "0", "--tolerance", "26", "--reach", "0.38"]
CUP = ["--at", "13:200,125", "--at", "13:150,140", "--at", "13:190,105", "--at", "13:230,135", "--at", "31:195,110"]
CUP += ["--tolerance", "14", "--avoid", "13:330,200", "--avoid", "13:60,60", "--avoid", "13:300,60"]
PLANT = ["--at", "image005:231,200", "--at", "image005:180,110", "--tolerance", "14"]
PLANT += ["--avoid", "image005:450,300", "--avoid", "image005:230,325", "--avoid", "image005:80,80"]
# name: (work folder, selection flags, edit flags)
CASES = {
    "lego shovel, recolored": ("lego-400x400", SHOVEL, ["--recolor", "--palette", "all=#2050d0"]),
    "lego shovel, starry_night": ("lego-400x400", SHOVEL, ["--style", "starry_night.jpg"]),
    "fox head, recolored": ("fox-270x480", HEAD, ["--recolor", "--palette", "all=#2050d0"]),
    "fox head, starry_night": ("fox-270x480", HEAD, ["--style", "starry_night.jpg"]),
    "cup, recolored": ("cup-400x300", CUP, ["--recolor", "--palette", "all=#d03040"]),
    "fern plant, recolored": ("fern-504x378", PLANT, ["--recolor", "--palette", "all=#d06020"]),
}
PUBLISHED = {"edit-dataset": 16, "edit": 133, "scene": 32, "field": 129}  # LAENeRF, supplement, table 3, on a GPU


def stylerf(*arguments: str) -> dict:
    """Run one command; return its --json object."""
    command = [sys.executable, "-m", "stylerf_cli.main", *arguments, "--json"]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def measure(fitted: Path, styles: Path, case: str, kept: Path) -> dict:
    """Return one row: an edit from selection to fine-tuned field, and its evaluation."""
    folder, selection, look = CASES[case]
    work = kept / folder
    if not work.exists():
        shutil.copytree(fitted / folder / "scene", work / "scene")
        shutil.copytree(fitted / folder / "field" / "fit-60s", work / "field" / "fit-60s")
    look = [str(styles / one) if one.endswith(".jpg") else one for one in look]
    name = case.replace(", ", "-").replace(" ", "-")
    load = round(os.getloadavg()[0], 2)
    made = stylerf("edit", str(work), *selection, *look, "--name", name)
    # A changed palette was learned by the preceding edit.
    trained = f"{name}-learned" if "--palette" in look else name
    learned = json.loads((work / "edit" / trained / "manifest.json").read_text())
    seconds = dict(made["seconds"])
    if "--palette" in look:
        seconds["edit"] = round(seconds["edit"] + learned["seconds"], 1)
    figures = stylerf("eval", str(work), "--of", name, "--region", name)["figures"]
    wanted = ("background_mse", "background_ratio", "change_inside", "change_lab", "bleeding", "region_share")
    return {
        "case": case, "selection_seconds": seconds.pop("region"), "seconds": seconds,
        "seconds_after_selection": round(sum(seconds.values()), 1),
        "colors": learned["figures"]["colors"], "sparsity": learned["figures"]["sparsity"],
        "palette_variation": learned["figures"]["palette_variation"], "region_psnr": learned["figures"]["psnr"],
        **{key: round(figures[key], 6) for key in wanted if key in figures},
        "load_before": load,
    }  # fmt: skip


def main() -> None:
    fitted, out, styles = (Path(one) for one in sys.argv[1:4])
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        kept = Path(os.environ.get("STYLERF_BENCH_WORK", scratch))
        for case in sys.argv[4:] or CASES:
            rows.append(measure(fitted, styles, case, kept))
            print(rows[-1], flush=True)
            report = {
                "command": "python -m benchmarks.edits FITTED OUT.json STYLES",
                "protocol": __doc__.split("Protocol: ")[1], "published_seconds": PUBLISHED,
                "flags": {name: " ".join(CASES[name][1] + CASES[name][2]) for name in CASES},
                **here_and_now(), "rows": rows,
            }  # fmt: skip
            out.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
