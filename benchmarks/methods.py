"""Every method on the same scenes and paintings: `python -m benchmarks.methods OUT.json [REMARK]`.

Protocol: `stylerf farm benchmarks/tables/methods.yaml` runs one table. Every method has a fixed number of steps;
fields, seeds and views are shared. Values are means over test views, then over seeds; rank: mean over scenes and
paintings, 1 is best; relative: a value divided by the mean over methods. Style is evaluated with a network that no
method optimizes. An interrupted farm resumes where it stopped, so no job runs twice. `job_hours` sums the seconds of
all artifacts. `least_seconds` of a scene and a method: time of the stage, on one thread next to another job, minimum
over paintings and seeds, since the steps are the same; `deform` is the stage that `desrf` requires first.
"""

import json
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

from benchmarks.conditions import here_and_now

ROOT = Path(__file__).resolve().parents[1]
TABLE, FOLDER = ROOT / "benchmarks" / "tables" / "methods.yaml", ROOT / "out" / "methods"
FROM_TABLE = ("cells", "standings", "fronts", "missing")


def condensed(folder: Path) -> dict:
    """Return a summary of a table's folder: its figures, and the total hours that its artifacts took."""
    content = json.loads((folder / "report" / "table.json").read_text())
    paths = folder.glob("*/*/*/manifest.json")
    took = {path.parent: float(json.loads(path.read_text())["seconds"]) for path in paths}
    seconds = defaultdict(list)
    for cell in content["cells"]:
        scene, method = folder / cell["scene"] / "field", cell["method"]
        for seed in cell["seeds"]:
            for name, artifact in ((method, f"{cell['style']}-{method}-s{seed}"), ("deform", f"fit-deformed-s{seed}")):
                if scene / artifact in took:
                    seconds[cell["scene"], name].append(took[scene / artifact])
    least = [
        {"scene": scene, "method": method, "seconds": round(min(all_), 1)} for (scene, method), all_ in seconds.items()
    ]
    return {
        "conditions": {"seeds": len(content["seeds"])},
        "artifacts": len(took),
        "job_hours": round(sum(took.values()) / 3600, 2),
        "least_seconds": least,
        **{name: content[name] for name in FROM_TABLE},
    }


def main() -> None:
    out, remark = Path(sys.argv[1]), sys.argv[2:]
    farmed = subprocess.run([sys.executable, "-m", "stylerf_cli.main", "farm", TABLE, "--cores", "2"], check=False)
    report = {
        "command": "python -m benchmarks.methods OUT.json",
        "protocol": __doc__.split("Protocol: ")[1],
        **here_and_now(),
        **({"remark": remark[0]} if remark else {}),
        **condensed(FOLDER),
    }
    out.write_text(json.dumps(report, indent=1) + "\n")
    sys.exit(farmed.returncode)


if __name__ == "__main__":
    main()
