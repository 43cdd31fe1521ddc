"""Plan a table of 40 scenes x 12 paintings: `python -m benchmarks.tables.forty_by_twelve OUT.json`.

Protocol: a table of 40 captures and 12 paintings with the default method, one seed, budgets of 2 min for fit and style,
an orbit of 60 frames in 4 shards, evaluations along it; estimated with stages/farm/costs.json and scheduled for 2 and
for 64 cores, 2 threads per job. Nothing is run: the 64 cores are assumed to be like the two that were measured, and not
to slow each other down. The GPU row uses the budgets that were run on one H200 (benchmarks/results/gpu.json: fits of
20 s, stylizations of 30 s, whose quality differs from those on two cores) and estimates everything else as on two
cores. No such table was measured.
"""

import json
import sys
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.conditions import here_and_now
from schemas.images import write_png
from stages.farm.run import farm_of, planned
from stages.farm.table import read_table
from stylerf_cli.verbs.farm import build

SCENES, PAINTINGS = 40, 12


def planned_for(cores: int, fit: str, style: str, folder: Path) -> dict:
    """Return the plan in a few numbers."""
    write_png(folder / "painting.png", np.zeros((8, 8, 3), np.uint8))
    content = {
        "scenes": {f"scene{number}": "photos" for number in range(SCENES)},
        "styles": {f"painting{number}": "painting.png" for number in range(PAINTINGS)},
        "fit": {"budget": fit}, "stylize": {"budget": style}, "render": {"path": "orbit", "shards": 4},
        "eval": {"path": "orbit"},
    }  # fmt: skip
    (folder / "table.yaml").write_text(json.dumps(content))
    plan = planned(farm_of(read_table(folder / "table.yaml", build)), cores)["plan"]
    return {
        "cores": cores,
        "jobs": sum(rule["jobs"] for rule in plan["rules"]),
        "hours": round(plan["wall_seconds"] / 3600, 1),
        "longest_chain_hours": round(plan["longest_seconds"] / 3600, 2),
        "work_hours": round(plan["work_seconds"] / 3600, 1),
        "disk_gb": round(plan["disk_mb"] / 1000),
        "hours_by_rule": {rule["rule"]: round(rule["seconds"] / 3600, 1) for rule in plan["rules"]},
    }


def main() -> None:
    """Write the plans."""
    with tempfile.TemporaryDirectory() as folder:
        plans = {
            "two cores": planned_for(2, "120s", "120s", Path(folder)),
            "64 cores": planned_for(64, "120s", "120s", Path(folder)),
            "one GPU and 2 cores, not measured": planned_for(2, "20s", "30s", Path(folder)),
        }
    result = {
        "command": "python -m benchmarks.tables.forty_by_twelve OUT.json",
        "protocol": __doc__.partition("Protocol: ")[2].strip(),
        **here_and_now(),
        "measured": False,
        "plans": plans,
    }
    Path(sys.argv[1]).write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
