"""Fit real scenes and evaluate held-out views: `python -m benchmarks.fits DATA OUT.json BUDGETS [NAMES]`.

With $STYLERF_BENCH_WORK, the work folders are kept there.

Protocol: `stylerf import` with the flags below, `stylerf fit --budget B` (only training itself is timed, without
reading, compilation, decisions or rendering), `stylerf eval`: mean PSNR of the test views (every 8th, or those defined
by the files) on white for objects, on black for captures. One seed. Peak memory is that of the fit's process.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.conditions import here_and_now

SCENES = {
    "lego 200x200": ("lego", ["--downscale", "4"]),
    "lego 400x400": ("lego", ["--downscale", "2"]),
    "fern 504x378": ("fern", ["--images", "images_8"]),
    "flower 504x378": ("flower", ["--images", "images_8"]),
    "fox 270x480": ("fox", ["--downscale", "4"]),
    "cup 400x300": ("cup", ["--downscale", "2"]),
}


def stylerf(*arguments: str) -> dict:
    """Run one command; return its --json object."""
    command = [sys.executable, "-m", "stylerf_cli.main", *arguments, "--json"]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def measure(data: Path, name: str, budget: str, work: Path) -> dict:
    """Return one row: a scene at a budget."""
    folder, flags = SCENES[name]
    stylerf("import", str(data / folder), str(work), *flags)
    label = f"fit-{budget}"
    load = round(os.getloadavg()[0], 2)
    fitted = stylerf("fit", str(work), "--budget", budget, "--no-buffers", "--name", label)
    manifest = json.loads((work / "field" / label / "manifest.json").read_text())
    figures = stylerf("eval", str(work), "--of", label)["figures"]
    return {
        "scene": name, "budget": budget, "psnr": round(figures["psnr"], 2), "ssim": round(figures["ssim"], 4),
        "parameters": fitted["figures"]["parameters"], "steps": fitted["figures"]["steps"],
        "resolution": fitted["figures"]["resolution"], "train_seconds": fitted["figures"]["train_seconds"],
        "wall_seconds": round(manifest["seconds"], 1), "peak_memory_mb": round(manifest["peak_memory_mb"]),
        "load_before": load,
    }  # fmt: skip


def main() -> None:
    data, out, budgets = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3].split(",")
    wanted = sys.argv[4:] or list(SCENES)
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        kept = os.environ.get("STYLERF_BENCH_WORK", scratch)
        for name in wanted:
            for budget in budgets:
                rows.append(measure(data, name, budget, Path(kept) / name.replace(" ", "-")))
                print(rows[-1], flush=True)
                report = {
                    "command": f"python -m benchmarks.fits DATA OUT.json {sys.argv[3]}",
                    "protocol": __doc__.split("Protocol: ")[1],
                    **here_and_now(), "rows": rows,
                }  # fmt: skip
                out.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
