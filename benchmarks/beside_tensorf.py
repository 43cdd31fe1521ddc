"""Ours beside the official TensoRF code: `python -m benchmarks.beside_tensorf DATA OUT.json SHIPPED.json SHORT.json`.

The last two are what `python -m benchmarks.tensorf` wrote: its schedule as it is, and compressed to its steps. With
$STYLERF_BENCH_WORK our work folder is kept there, and what it holds is not made again.

Protocol: lego's training photos at 200x200 for all. Ours: `stylerf fit --budget Ns`, again for each N until its fit has
28 dB, then once for 60 s; the mean PSNR of all test views by `stylerf eval`; the time to a quality is the smallest N
that reaches it. Theirs: see benchmarks/tensorf.py, three test views, evenly spread, looked at every 50 steps. Data
loading, compiling and judging are on nobody's clock. Peak memory is that of the process, ours of the fit of 60 s. One
seed.
"""

import json
import os
import sys
import tempfile
from pathlib import Path

from benchmarks.conditions import here_and_now
from benchmarks.fits import SCENES, stylerf

SCENE, QUALITIES = "lego 200x200", (24.0, 28.0)
BUDGETS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 30)
LONG = 60


def time_to(curve: list[dict], quality: float) -> float | None:
    """Seconds of the first entry of a curve {seconds, psnr} that has `quality` dB; None if none has."""
    return next((entry["seconds"] for entry in curve if entry["psnr"] >= quality), None)


def row(code: str, schedule: str, curve: list[dict], parameters: int, memory: float) -> dict:
    """A line of the table."""
    times = {f"seconds_to_{quality:.0f}_db": time_to(curve, quality) for quality in QUALITIES}
    last = curve[-1]
    return {
        "code": code, "schedule": schedule, **times, "last_psnr": last["psnr"], "last_seconds": last["seconds"],
        "parameters": parameters, "peak_memory_mb": memory, "curve": curve,
    }  # fmt: skip


def ours(data: Path, work: Path) -> dict:
    """Fits of growing budgets."""
    folder, flags = SCENES[SCENE]
    stylerf("import", str(data / folder), str(work), *flags)
    curve = []
    for budget in (*BUDGETS, LONG):
        if budget != LONG and time_to(curve, QUALITIES[-1]) is not None:
            continue
        name = f"beside-{budget}s"
        fitted = stylerf("fit", str(work), "--budget", f"{budget}s", "--no-buffers", "--name", name)["figures"]
        psnr = stylerf("eval", str(work), "--of", name)["figures"]["psnr"]
        curve.append({"seconds": fitted["train_seconds"], "psnr": round(psnr, 3), "step": fitted["steps"]})
        print(curve[-1], flush=True)
    manifest = json.loads((work / "field" / name / "manifest.json").read_text())
    return row("stylerf", "a new fit per budget", curve, fitted["parameters"], round(manifest["peak_memory_mb"]))


def theirs(report: dict) -> dict:
    """Of what benchmarks/tensorf.py wrote."""
    schedule = "as shipped" if report["name"] == "shipped" else f"compressed to {report['command'].split()[-1]} steps"
    return row("TensoRF", schedule, report["curve"], report["parameters"], report["peak_memory_mb"])


def main() -> None:
    data, out, *reports = map(Path, sys.argv[1:])
    rows = [theirs(json.loads(report.read_text())) for report in reports]
    with tempfile.TemporaryDirectory() as scratch:
        kept = Path(os.environ.get("STYLERF_BENCH_WORK", scratch))
        rows.insert(0, ours(data, kept / SCENE.replace(" ", "-")))
    report = {
        "command": "python -m benchmarks.beside_tensorf DATA OUT.json SHIPPED.json SHORT.json",
        "protocol": __doc__.split("Protocol: ")[1], **here_and_now(), "rows": rows,
    }  # fmt: skip
    out.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
