"""Every method on the same scenes and paintings: `python -m benchmarks.methods OUT.json [REMARK]`.

Protocol: `stylerf farm benchmarks/tables/methods.yaml` runs one table. Steps of a method are those that it takes in
30 s on fern at 252x189 with one thread of the machine below, so every method has about the same time; fields, seeds and
views are shared. Values are means over test views, then over seeds; rank: mean over scenes and paintings, 1 is best;
relative: a value divided by the mean over methods. Style is judged by a network that no method matches. A farm that was
interrupted continues where it was, so no job runs twice. `job_hours` sums the seconds of all artifacts.
"""

import json
import subprocess
import sys
from pathlib import Path

from benchmarks.conditions import here_and_now

ROOT = Path(__file__).resolve().parents[1]
TABLE, FOLDER = ROOT / "benchmarks" / "tables" / "methods.yaml", ROOT / "out" / "methods"
FROM_TABLE = ("cells", "standings", "fronts", "missing")


def condensed(folder: Path) -> dict:
    """What is kept of a table's folder: its figures, and the hours that its artifacts took in all."""
    content = json.loads((folder / "report" / "table.json").read_text())
    manifests = [json.loads(path.read_text()) for path in folder.glob("*/*/*/manifest.json")]
    return {
        "conditions": {"seeds": len(content["seeds"])},
        "artifacts": len(manifests),
        "job_hours": round(sum(float(manifest["seconds"]) for manifest in manifests) / 3600, 2),
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
