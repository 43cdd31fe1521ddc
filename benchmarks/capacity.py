"""Accuracy against size: `python -m benchmarks.capacity DATA OUT.json [BUDGET [SCENE...]]`.

With $STYLERF_BENCH_WORK, the work folders are kept there.

Protocol: every scene is fitted at each fixed capacity (vertices x density rank x color rank, grown to as in the
product) and with `--capacity grow`, all for BUDGET (seconds of training, or steps) on the same rays, one seed; mean
PSNR of the test views by `stylerf eval`.
"""

import json
import os
import sys
import tempfile
from pathlib import Path

from benchmarks.conditions import here_and_now
from benchmarks.fits import SCENES, stylerf

CAPACITIES = ("128x8x16", "192x16x24", "256x16x24", "grow")
# The largest capacity of a field in a contraction.
BEYOND = {"fox 270x480": ("384x16x24",)}
BUDGET = "60s"


def imported(data: Path, name: str, work: Path) -> None:
    """Import a scene of benchmarks.fits, or create the demo's `still life`."""
    if name != "still life":
        folder, flags = SCENES[name]
        stylerf("import", str(data / folder), str(work), *flags)
        return
    from stages.configs.demo import DemoConfig
    from stages.pipeline.demo_scene import write_demo
    from stages.run.progress import Silent

    config, photos = DemoConfig(), work.parent / "still-life-photos"
    if not photos.exists():
        write_demo(photos, config.size, config.train_views, config.test_views, 0, os.cpu_count() or 1, Silent())
    stylerf("import", str(photos), str(work))


def measure(name: str, capacity: str, budget: str, work: Path) -> dict:
    """Return one row."""
    label = f"capacity-{capacity}"
    requested = "grow" if capacity == "grow" else f"fixed:{capacity}"
    options = "--budget", budget, "--capacity", requested, "--no-buffers", "--name", label
    load = round(os.getloadavg()[0], 2)
    figures = stylerf("fit", str(work), *options)["figures"]
    quality = stylerf("eval", str(work), "--of", label)["figures"]
    return {
        "scene": name,
        "capacity": capacity,
        "psnr": round(quality["psnr"], 3),
        "parameters": figures["parameters"],
        "steps": figures["steps"],
        "train_seconds": figures["train_seconds"],
        "load_before": load,
        "decisions": figures["decisions"],
    }


def main() -> None:
    data, out = Path(sys.argv[1]), Path(sys.argv[2])
    budget = sys.argv[3] if len(sys.argv) > 3 else BUDGET
    wanted, rows = sys.argv[4:] or ["lego 200x200", "fern 504x378", "fox 270x480", "still life"], []
    with tempfile.TemporaryDirectory() as scratch:
        kept = Path(os.environ.get("STYLERF_BENCH_WORK", scratch))
        for name in wanted:
            work = kept / name.replace(" ", "-")
            imported(data, name, work)
            for capacity in (*BEYOND.get(name, ()), *CAPACITIES):
                rows.append(measure(name, capacity, budget, work))
                print(rows[-1], flush=True)
                report = {
                    "command": f"python -m benchmarks.capacity DATA OUT.json {budget}",
                    "protocol": __doc__.split("Protocol: ")[1],
                    **here_and_now(),
                    "rows": rows,
                }
                out.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
