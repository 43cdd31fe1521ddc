"""Charts of metrics against cost, one per family and cost: one panel per metric, one color per group."""

from collections.abc import Sequence
from typing import Literal

from stages.comparison.pareto_fronts import Panel, panel_of
from stages.comparison.runs import CHARTED, COSTS, EDITS, FITS, STYLIZATIONS, Run
from stages.report.charts import INK, SETTINGS, Chart, finish
from stages.report.formatting import count
from stylerf.environment.matplotlib_defaults import Axes, Line2D, LogFormatter, rc_context, to_hex, to_rgb
from stylerf.environment.matplotlib_defaults import Figure as Drawing

# Okabe and Ito's color-blind safe palette, without the yellow, which is illegible on white.
COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#888888")
LineStyle = Literal["-", "--", ":", "-."]
LINES: tuple[LineStyle, ...] = ("-", "--", ":", "-.")  # groups beyond the palette reuse its colors, darker each time
DARKER = 0.6
MARKERS = "osD^vPX*"
AXES = {
    "seconds": ("seconds", "Time"),
    "peak_memory_mb": ("peak memory, MB", "Peak memory"),
    "parameters": ("parameters", "Parameters"),
}
TITLES = {FITS: "Fits", STYLIZATIONS: "Stylizations", EDITS: "Local edits"}
MAX_NAMED_POINTS = 14  # panels with more points carry no names
LOG_AXIS_RATIO = 8.0  # of the largest to the smallest cost, above which the axis is logarithmic


def comparison_charts(runs: Sequence[Run]) -> list[Chart]:
    """Draw a chart per family with measured runs and per cost: `fits_seconds`, `edits_parameters`, ..."""
    charts = []
    for family in (FITS, STYLIZATIONS, EDITS):
        members = [run for run in runs if run.family == family]
        for cost in COSTS:
            panels = [panel for key in CHARTED[family] if (panel := panel_of(members, key, cost))]
            if panels:
                charts.append(_chart(family, cost, panels))
    return charts


def _chart(family: str, cost: str, panels: list[Panel]) -> Chart:
    shown = list({run.title: run for panel in panels for run in panel.runs}.values())
    groups = {group: group_style(i) for i, group in enumerate(dict.fromkeys(run.group for run in shown))}
    methods = {one: MARKERS[i % len(MARKERS)] for i, one in enumerate(dict.fromkeys(run.method for run in shown))}
    columns = min(2, len(panels))
    rows = -(-len(panels) // columns)
    with rc_context(SETTINGS):
        drawing = Drawing(figsize=(6.0 + 3.5 * (columns - 1), 3.2 * rows + 0.9), layout="constrained")
        grid = drawing.add_gridspec(rows, columns)
        for index, panel in enumerate(panels):
            axes = drawing.add_subplot(grid[divmod(index, columns)])
            _draw(axes, panel, groups, methods)
        _legend(drawing, groups, methods)
        title = f"{TITLES[family]}: metrics against {AXES[cost][1].lower()}"
        return finish(drawing, f"{family}_{cost}", title, "; ".join(map(_description, panels)))


def group_style(index: int) -> tuple[str, LineStyle]:
    """Color and line style of a group; the first 28 are distinct."""
    reuse, color = divmod(index, len(COLORS))
    red, green, blue = (part * DARKER**reuse for part in to_rgb(COLORS[color]))
    return to_hex((red, green, blue)), LINES[reuse % len(LINES)]


def _draw(axes: Axes, panel: Panel, groups: dict[str, tuple[str, LineStyle]], methods: dict[str, str]) -> None:
    leading = {run.title for front in panel.fronts for run in front}
    for run in panel.runs:
        color, _ = groups[run.group]
        fill = color if run.title in leading else "none"
        axes.plot(*panel.at(run), methods[run.method], color=color, markerfacecolor=fill, markersize=7, zorder=3)
    for front in panel.fronts:
        points = [panel.at(run) for run in front]
        color, line = groups[front[0].group]
        axes.step(*zip(*points), line, where="post", color=color, linewidth=1.3, alpha=0.8, zorder=2)
    if len(panel.runs) <= MAX_NAMED_POINTS:
        for run in panel.runs:
            axes.annotate(run.name, panel.at(run), xytext=(5, 4), textcoords="offset points", fontsize=7.5, color=INK)
    costs = [panel.at(run)[0] for run in panel.runs]
    if min(costs) > 0 and max(costs) > LOG_AXIS_RATIO * min(costs):
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter(LogFormatter())
        axes.xaxis.set_minor_formatter(LogFormatter())  # the default formatter writes TeX
    axes.margins(x=0.2, y=0.14)
    axes.set_xlabel(AXES[panel.cost][0])
    if panel.cost == "parameters":
        axes.xaxis.set_major_formatter(lambda value, _: count(value))
        axes.tick_params(axis="x", labelrotation=20, labelsize=8)
    better = f"{panel.better} is better" if panel.better else ""
    axes.set_title(f"{_wrapped(panel.label)}{f' ({panel.unit})' if panel.unit else ''}", fontsize=9.5)
    axes.set_ylabel(better, fontsize=8.5)
    axes.grid()


def _legend(drawing: Drawing, groups: dict[str, tuple[str, LineStyle]], methods: dict[str, str]) -> None:
    handles = [
        Line2D([], [], color=color, linestyle=line, linewidth=3, label=group) for group, (color, line) in groups.items()
    ]
    handles += [
        Line2D([], [], color=INK, marker=marker, linestyle="", markerfacecolor="none", label=method)
        for method, marker in methods.items()
    ]
    handles.append(Line2D([], [], color=INK, marker="o", linewidth=1.3, label="Pareto front (filled)"))
    drawing.legend(handles=handles, loc="outside lower left", ncols=3, fontsize=8)


def _wrapped(label: str) -> str:
    """Break a long label in two lines; the protocol in brackets stays whole."""
    head, comma, tail = label.partition(", ")
    return f"{head}{comma}\n{tail}" if len(label) > 46 and comma else label


def _description(panel: Panel) -> str:
    names = "; ".join(", ".join(run.title for run in front) for front in panel.fronts)
    return f"{panel.label} of {len(panel.runs)} runs" + (f", on the front: {names}" if names else "")
