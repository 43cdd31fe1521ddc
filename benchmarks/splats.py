"""Compare splats with their fields: `python -m benchmarks.splats WORK OUT.json [BUDGET [SPLATS [FIELD...]]]`.

Protocol: every field of the work folder (or those named) is exported with BUDGET (seconds, or steps) and SPLATS; PSNR
at held-out views, of the splats against the field and of both against the photos, as reported by `stylerf export`. The
system load before each export is recorded, since time budgets are wall time.
"""

import json
import os
import sys
from pathlib import Path

from benchmarks.conditions import here_and_now
from benchmarks.fits import stylerf

BUDGET, SPLATS = "120s", 300_000
FIGURES = (
    "splats", "placed", "degree", "views", "steps", "optimize_seconds", "psnr_to_field", "psnr_to_photos",
    "field_psnr_to_photos", "held_out_views",
)  # fmt: skip


def measure(work: Path, field: str, budget: str, splats: int) -> dict:
    """Return a row."""
    load = round(os.getloadavg()[0], 2)
    options = ("--as", "splats", "--splats", str(splats), "--budget", budget, "--name", f"{field}-splats-benchmark")
    exported = stylerf("export", str(work), "--of", field, *options)["figures"]
    found = {name: exported[name] for name in FIGURES if name in exported}
    return {"work": work.name, "field": field, "budget": budget, "load_before": load, **found}


def main() -> None:
    work, out = Path(sys.argv[1]), Path(sys.argv[2])
    budget = sys.argv[3] if len(sys.argv) > 3 else BUDGET
    splats = int(sys.argv[4]) if len(sys.argv) > 4 else SPLATS
    fields = sys.argv[5:] or sorted(path.name for path in (work / "field").iterdir())
    rows = [measure(work, field, budget, splats) for field in fields]
    report = {
        "command": f"python -m benchmarks.splats WORK OUT.json {budget} {splats}",
        "protocol": __doc__.split("Protocol: ")[1],
        **here_and_now(),
        "rows": rows,
    }
    out.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
