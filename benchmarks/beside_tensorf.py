"""Compare with the official TensoRF code: `python -m benchmarks.beside_tensorf DATA OUT.json SHIPPED.json SHORT.json`.

The last two are outputs of `python -m benchmarks.tensorf`: its schedule as shipped, and compressed to its steps. With
$STYLERF_BENCH_WORK, our work folder is kept there and existing results are reused.

Protocol: lego's training photos at 200x200 for both. Ours: `stylerf fit --budget Ns`, a separate fit for each N until
one reaches 28 dB, then one for 60 s; mean PSNR of all test views by `stylerf eval`; the time to a quality is the
smallest N that reaches it. Theirs: see benchmarks/tensorf.py, three evenly spaced test views, evaluated every 50 steps.
Data loading, compilation and evaluation are excluded from all times. Peak memory is that of the process, for ours of
the 60 s fit. One seed.
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
    """Return the seconds of the first entry of a curve {seconds, psnr} that reaches `quality` dB; None if none does."""
    return next((entry["seconds"] for entry in curve if entry["psnr"] >= quality), None)


def row(code: str, schedule: str, curve: list[dict], parameters: int, memory: float) -> dict:
    """Return a row of the table."""
    times = {f"seconds_to_{quality:.0f}_db": time_to(curve, quality) for quality in QUALITIES}
    last = curve[-1]
    return {
        "code": code, "schedule": schedule, **times, "last_psnr": last["psnr"], "last_seconds": last["seconds"],
        "parameters": parameters, "peak_memory_mb": memory, "curve": curve,
    }  # fmt: skip


def ours(data: Path, work: Path) -> dict:
    """Return the row of our fits with increasing budgets."""
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
    """Return the row for an output of benchmarks/tensorf.py."""
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
