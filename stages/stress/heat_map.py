"""The heat map: faults down, methods across, the share of runs that succeeded as color and number."""

from collections.abc import Sequence

import numpy as np

from stages.configs.faults import METHODS
from stages.report.charts import INK, SETTINGS, Chart, finish
from stages.stress.success_rates import REMEDIED, Cell
from stylerf.environment.matplotlib_defaults import Axes, QuadMesh, colormaps, rc_context
from stylerf.environment.matplotlib_defaults import Figure as Drawing

COLORS = "cividis"  # even to the eye, and read alike by those who do not tell red from green
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
        return finish(drawing, "heat_map", "Success of methods under faults", _told(cells))


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


def _told(cells: Sequence[Cell]) -> str:
    failing = [cell for cell in cells if cell.successes < cell.count]
    whole = f"{len(cells) - len(failing)} of {len(cells)} cells succeed with every seed"
    if not failing:
        return whole
    worst = sorted(failing, key=lambda cell: cell.rate)[:6]
    return f"{whole}; the worst: " + ", ".join(
        f"{cell.method} under {cell.fault} {cell.successes} of {cell.count}" for cell in worst
    )
