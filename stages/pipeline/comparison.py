"""Compare the fits, stylizations and edits of work folders: cost against quality, from what is there."""

import shlex
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from schemas.errors import ArtifactStale
from schemas.work_folder import WorkFolder


def compared(works: Sequence[WorkFolder], out: Path) -> dict[str, Any]:
    """Write compare.json, runs.csv, compare.html and charts/ to `out`; return what compare.json holds.

    Raises:
        ArtifactStale: none of the work folders holds a field.
    """
    from schemas.atomic_write import sweeping, write_bytes, write_json
    from stages.comparison.page import FAMILIES, build_page, comparison_charts, rows_of
    from stages.comparison.pareto_fronts import disagreements, on_fronts
    from stages.comparison.runs import CHARTED, runs_of, thread_mismatches
    from stages.evaluation.metrics import write_csv

    with sweeping((out, out / "charts")):
        runs, gaps = runs_of(works)
        if not runs:
            command = shlex.join(["stylerf", "fit", str(works[0].root)])
            raise ArtifactStale(f"no field to compare in {works[0].root}; make one with: {command}")
        fronts: dict[str, list[str]] = {}
        for family in FAMILIES:
            members = [one for one in runs if one.family == family]
            gaps += thread_mismatches(members)
            gaps += disagreements(members, list(CHARTED[family]))
            fronts |= on_fronts(members, list(CHARTED[family]))
        charts = comparison_charts(runs)
        for chart in charts:
            write_bytes(out / "charts" / f"{chart.name}.svg", chart.svg.encode())
            write_bytes(out / "charts" / f"{chart.name}.png", chart.png)
        write_csv(out / "runs.csv", rows_of(runs, fronts))
        write_bytes(out / "compare.html", build_page(runs, charts, gaps, fronts).encode())
        content = {
            "works": [work.root for work in works],
            "runs": [asdict(one) | {"fronts": fronts[one.title]} for one in runs],
            "missing": [asdict(gap) for gap in gaps],
            "charts": [f"charts/{chart.name}.svg" for chart in charts],
        }
        write_json(out / "compare.json", content)
    return content
