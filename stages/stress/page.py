"""The HTML page of a stress test, and its rows for CSV."""

import base64
from collections.abc import Sequence
from pathlib import Path

from schemas.errors import BadInput
from schemas.safe_reading import read_bytes
from stages.configs.faults import FAULTS, METHODS
from stages.evaluation.metrics import Row
from stages.report.charts import Chart
from stages.report.pages import render_page
from stages.stress import criteria
from stages.stress.baseline import Compared
from stages.stress.success_rates import REMEDIED, Cell, Outcome

LARGEST_PICTURE = 64 << 20  # bytes; two views of 4000 pixels a side are 50 MB at most


def cell_rows(cells: Sequence[Cell]) -> list[Row]:
    """One flat row per cell."""
    keys = ("method", "fault", "successes", "count", "rate", "median", "spread", "lowest", "seconds")
    return [
        {key: getattr(cell, key) for key in keys} | {"worst_seed": cell.worst.seed, "why": " | ".join(cell.whys)}
        for cell in cells
    ]


def run_rows(outcomes: Sequence[Outcome]) -> list[Row]:
    """One flat row per run."""
    keys = ("fault", "seed", "ok", "score", "seconds", "why")
    return [{"method": one.label, **{key: getattr(one, key) for key in keys}, **one.figures} for one in outcomes]


def build_page(
    cells: Sequence[Cell],
    chart: Chart,
    conditions: dict,
    missing: Sequence[tuple[str, str]],
    compared: Compared | None,
    worst: Path,
) -> str:
    """The page of a stress test. missing: (what, why) of trials that did not run. worst: folder of the worst views."""
    runs, successes = sum(cell.count for cell in cells), sum(cell.successes for cell in cells)
    return render_page(
        "stress.html",
        summary=f"{successes} of {runs} runs succeed, over {len(cells)} combinations of method and fault.",
        chart=chart,
        compared=compared,
        cells=[(cell, _score_of(cell)) for cell in cells],
        pictures=list(filter(None, (_picture(cell, worst) for cell in cells))),
        limits=criteria,
        conditions={"work": ""} | conditions,
        settings=", ".join(f"{key} {value}" for key, value in conditions.items() if value != ""),
        faults=[{"what": fault.name, "why": fault.description} for fault in FAULTS.values()],
        missing=[{"what": what, "why": why} for what, why in missing],
    )


def _score_of(cell: Cell) -> dict:
    name, unit, digits = criteria.SCORES[METHODS[cell.method.removesuffix(REMEDIED)].family]
    return {"name": f"{name} ({unit})" if unit else name, "digits": digits}


def _picture(cell: Cell, folder: Path) -> dict | None:
    data = _png(folder, cell.worst.picture)
    if data is None:
        return None
    return {
        "uri": "data:image/png;base64," + base64.b64encode(data).decode("ascii"),
        "alt": f"{cell.method} under {cell.fault}, seed {cell.worst.seed}",
        "outcome": "lowest score, a success" if cell.worst.ok else "failed",
    }


def _png(folder: Path, name: str) -> bytes | None:
    """The PNG of that name in the folder itself; None if it is missing, a link or not a PNG."""
    path = folder / name
    if not name or path.is_symlink():
        return None
    try:
        data = read_bytes(path, LARGEST_PICTURE)
    except (BadInput, FileNotFoundError):
        return None
    return data if data.startswith(b"\x89PNG\r\n\x1a\n") else None
