"""Stylize a region with LAENeRF and with Ref-NPR: `python -m benchmarks.parts FITTED OUT.json STYLE [CASES]`.

FITTED holds a work folder per scene, fitted for 60 s, as for benchmarks.edits; each is copied. STYLE: a painting.

Protocol: a region is selected and stylized by `stylerf edit --style` (LAENeRF). `stylerf stylize --region --method
refnpr` with 40 s paints a view of the region and stylizes the region from it. The painted image (the photo outside the
region) is then passed to `stylerf stylize --method refnpr` with 40 s, which trains the whole field, as for Ref-NPR in
LAENeRF's comparison. All three are evaluated by `stylerf eval --region` on the held-out views: background MSE against
the photos, divided by that of the original field (ratio), change inside the region, bleeding next to it. Seconds are
from the stages' manifests, excluding selection. One seed.
"""

import json
import os
import shutil
import sys
import tempfile
from pathlib import Path

from benchmarks.conditions import here_and_now
from benchmarks.edits import HEAD, SHOVEL, stylerf
from benchmarks.palettes import row, seconds_of

CASES = {"lego shovel": ("lego-400x400", SHOVEL), "fox head": ("fox-270x480", HEAD)}
BUDGET = "40s"


def measure(fitted: Path, style: Path, case: str, kept: Path) -> list[dict]:
    """Return one row per method."""
    folder, selection = CASES[case]
    work, region = kept / folder, case.replace(" ", "-")
    if not (work / "scene").exists():
        shutil.copytree(fitted / folder / "scene", work / "scene")
        shutil.copytree(fitted / folder / "field" / "fit-60s", work / "field" / "fit-60s")
    made = stylerf("edit", str(work), *selection, "--style", str(style), "--name", region)
    seconds = {region: sum(made["seconds"].values()) - made["seconds"]["region"]}
    method = ("stylize", str(work), "--method", "refnpr", "--budget", BUDGET)
    made = stylerf(*method, "--region", region, "--style", str(style), "--name", "within")
    (reference,) = made["figures"]["references"]
    picture = work / f"{reference['view']}.png"
    shutil.copy(Path(made["field"]) / reference["file"], picture)
    stylerf(*method, "--of", "fit-60s", "--reference", f"{reference['view']}={picture}", "--name", "whole")
    seconds |= {name: seconds_of(work, f"field/{name}") for name in ("within", "whole")}
    words = {region: "laenerf", "within": "refnpr, of the region", "whole": "refnpr, of the whole field"}
    rows = []
    for name, label in words.items():
        figures = stylerf("eval", str(work), "--of", name, "--region", region)["figures"]
        rows.append(row(case, label, seconds[name], figures, {}))
    return rows


def main() -> None:
    fitted, out, style = (Path(one) for one in sys.argv[1:4])
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        kept = Path(os.environ.get("STYLERF_BENCH_WORK", scratch))
        for case in sys.argv[4:] or CASES:
            rows += measure(fitted, style, case, kept)
            print(*rows[-3:], sep="\n", flush=True)
            report = {
                "command": f"python -m benchmarks.parts FITTED OUT.json {style.name}",
                "protocol": __doc__.split("Protocol: ")[1],
                "flags": {name: " ".join(CASES[name][1]) for name in CASES},
                **here_and_now(), "rows": rows,
            }  # fmt: skip
            out.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
