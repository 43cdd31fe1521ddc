"""The HTML page of a stress run, with its heat map: faults down, methods across, the share of runs that succeeded."""

import base64
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from schemas.errors import BadInput
from schemas.safe_reading import read_bytes
from stages.configs.faults import FAULTS, METHODS
from stages.evaluation.metrics import Row
from stages.report.charts import INK, SETTINGS, Chart, finish
from stages.report.pages import render_page
from stages.stress import criteria
from stages.stress.baseline import Compared
from stages.stress.outcomes import REMEDIED, Cell, Outcome
from stylerf.environment.matplotlib_defaults import Axes, QuadMesh, colormaps, rc_context
from stylerf.environment.matplotlib_defaults import Figure as Drawing

COLORS = "cividis"  # perceptually uniform and safe for color blindness
STEPS = 11  # few enough that the bar beside the map stays lines in an SVG
DARK = 0.55  # share up to which text on it is white


def rates(cells: Sequence[Cell]) -> tuple[list[str], list[str], np.ndarray]:
    """Faults, methods, and [faults, methods] success rates; NaN where there is no such cell."""
    faults = list(dict.fromkeys(cell.fault for cell in cells))
    methods = list(dict.fromkeys(cell.method for cell in sorted(cells, key=_by_method)))
    table = np.full((len(faults), len(methods)), np.nan)
    for cell in cells:
        table[faults.index(cell.fault), methods.index(cell.method)] = cell.rate
    return faults, methods, table


def _by_method(cell: Cell) -> tuple[int, bool]:
    return list(METHODS).index(cell.method.removesuffix(REMEDIED)), cell.method.endswith(REMEDIED)


def heat_map(cells: Sequence[Cell]) -> Chart:
    """Each cell shows its successes of its runs and, below, the median of the scores with their spread."""
    faults, methods, _ = rates(cells)
    with rc_context(SETTINGS):
        drawing = Drawing(figsize=(2.2 + 1.25 * len(methods), 1.4 + 0.46 * len(faults)), layout="constrained")
        axes = drawing.add_subplot()
        mesh = draw_cells(axes, cells)
        bar = drawing.colorbar(mesh, ax=axes, fraction=0.04, pad=0.02, ticks=[0, 0.5, 1])
        bar.ax.set_yticklabels(["none", "half", "all"])
        bar.set_label("runs that succeed")
        return finish(drawing, "heat_map", "Success of methods under faults", _description(cells))


def draw_cells(axes: Axes, cells: Sequence[Cell]) -> QuadMesh:
    """The map alone, on axes of any drawing; the colored mesh for a bar beside it."""
    faults, methods, table = rates(cells)
    found = {(cell.fault, cell.method): cell for cell in cells}
    edges = np.arange(len(methods) + 1) - 0.5, np.arange(len(faults) + 1) - 0.5
    mesh = axes.pcolormesh(
        *edges,
        np.ma.masked_invalid(table),
        vmin=0,
        vmax=1,
        edgecolors="white",
        linewidth=1.5,
        cmap=colormaps[COLORS].resampled(STEPS),
    )
    for row, fault in enumerate(faults):
        for column, method in enumerate(methods):
            _write(axes, column, row, found.get((fault, method)))
    axes.set_xticks(range(len(methods)), [method.replace(REMEDIED, "\n+ remedies") for method in methods])
    axes.set_yticks(range(len(faults)), faults)
    axes.invert_yaxis()
    axes.xaxis.tick_top()
    axes.tick_params(length=0)
    axes.grid(False)
    for spine in axes.spines.values():
        spine.set_visible(False)
    return mesh


def _write(axes, column: int, row: int, cell: Cell | None) -> None:
    if cell is None:
        axes.text(column, row, "–", ha="center", va="center", color=INK, fontsize=9)
        return
    ink = "white" if cell.rate < DARK else "#111111"
    score = "" if cell.median is None else f"\n{cell.median:.3g}"
    if cell.spread is not None:
        score += f" ± {cell.spread:.2g}"
    text = f"{cell.successes}/{cell.count}{score}"
    axes.text(column, row, text, ha="center", va="center", color=ink, fontsize=7.5, linespacing=1.2)


def _description(cells: Sequence[Cell]) -> str:
    failing = [cell for cell in cells if cell.successes < cell.count]
    whole = f"{len(cells) - len(failing)} of {len(cells)} cells succeed with every seed"
    if not failing:
        return whole
    worst = sorted(failing, key=lambda cell: cell.rate)[:6]
    return f"{whole}; the worst: " + ", ".join(
        f"{cell.method} under {cell.fault} {cell.successes} of {cell.count}" for cell in worst
    )


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
