"""Accuracy against size: `python -m benchmarks.capacity DATA OUT.json [STEPS [SCENE...]]`.

With $STYLERF_BENCH_WORK the work folders are kept there.

Protocol: every scene is fitted at each fixed capacity (vertices x density rank x colour rank, climbed to as the product
does) and with `--capacity grow`, all for STEPS steps on the same rays, one seed; mean PSNR of the test views by
`stylerf eval`. Steps rather than seconds: what is compared is what a size can hold, and a busy machine changes nothing.
Seconds are those of the training itself, on a machine that may be busy.
"""

import json
import os
import platform
import sys
import tempfile
from datetime import UTC, datetime
from pathlib import Path

from benchmarks.fits import SCENES, stylerf

CAPACITIES = ("128x8x16", "192x16x24", "256x16x24", "grow")
STEPS = 800


def imported(data: Path, name: str, work: Path) -> None:
    """A scene of benchmarks.fits, or `still life`: the demo's."""
    if name != "still life":
        folder, flags = SCENES[name]
        stylerf("import", str(data / folder), str(work), *flags)
        return
    from stages.configs.demo import DemoConfig
    from stages.demo_data import write_demo
    from stages.progress import Silent

    config, photos = DemoConfig(), work.parent / "still-life-photos"
    if not photos.exists():
        write_demo(photos, config.size, config.train_views, config.test_views, 0, os.cpu_count() or 1, Silent())
    stylerf("import", str(photos), str(work))


def measure(name: str, capacity: str, steps: int, work: Path) -> dict:
    """One row."""
    label = f"capacity-{capacity}"
    asked = "grow" if capacity == "grow" else f"fixed:{capacity}"
    options = "--budget", str(steps), "--capacity", asked, "--no-buffers", "--name", label
    figures = stylerf("fit", str(work), *options)["figures"]
    quality = stylerf("eval", str(work), "--of", label)["figures"]
    return {
        "scene": name,
        "capacity": capacity,
        "psnr": round(quality["psnr"], 3),
        "parameters": figures["parameters"],
        "train_seconds": figures["train_seconds"],
        "decisions": figures["decisions"],
    }


def main() -> None:
    data, out = Path(sys.argv[1]), Path(sys.argv[2])
    steps = int(sys.argv[3]) if len(sys.argv) > 3 else STEPS
    wanted, rows = sys.argv[4:] or ["lego 200x200", "fern 504x378", "fox 270x480", "still life"], []
    with tempfile.TemporaryDirectory() as scratch:
        kept = Path(os.environ.get("STYLERF_BENCH_WORK", scratch))
        for name in wanted:
            work = kept / name.replace(" ", "-")
            imported(data, name, work)
            for capacity in CAPACITIES:
                rows.append(measure(name, capacity, steps, work))
                print(rows[-1], flush=True)
                report = {
                    "command": f"python -m benchmarks.capacity DATA OUT.json {steps}",
                    "protocol": __doc__.split("Protocol: ")[1],
                    "machine": {"cpu": platform.processor() or platform.machine(), "cores": os.cpu_count()},
                    "rows": rows,
                    "date": datetime.now(UTC).date().isoformat(),
                }
                out.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
