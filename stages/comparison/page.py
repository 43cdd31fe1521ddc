"""The HTML page of a comparison with its charts of metrics against cost, its rows for CSV, and its JSON."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from schemas.atomic_write import sweeping, write_bytes, write_json
from schemas.errors import ArtifactStale
from schemas.work_folder import WorkFolder
from stages.comparison.pareto_fronts import Panel, disagreements, on_fronts, panel_of, protocols_of
from stages.comparison.runs import (
    CHARTED,
    COSTS,
    EDITS,
    FITS,
    STYLIZATIONS,
    Gap,
    Protocol,
    Run,
    RunMetric,
    runs_of,
    unlike_machines,
)
from stages.evaluation.metric_definitions import BY_KEY
from stages.evaluation.metrics import Row, write_csv
from stages.report.charts import INK, SETTINGS, Chart, finish
from stages.report.pages import count, number, render_page
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
MAX_NAMED_POINTS = 14  # panels with more points show no names
LOG_AXIS_RATIO = 8.0  # ratio of the largest to the smallest cost above which the axis is logarithmic


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


FAMILIES = (FITS, STYLIZATIONS, EDITS)
LETTERS = "abcdefghijklmnopqrstuvwxyz"


@dataclass(frozen=True)
class MetricCell:
    """A metric of a run in the table. letter: distinguishes the protocols of a group, empty if there is one."""

    text: str
    on_front: bool = False
    letter: str = ""
    protocol: str = ""


@dataclass(frozen=True)
class Family:
    """A section of the page: charts and a table with one row per run."""

    title: str
    charts: Sequence[Chart]
    columns: Sequence[str]
    rows: Sequence[tuple[Run, Sequence[MetricCell]]]


def rows_of(runs: Sequence[Run], fronts: Mapping[str, Sequence[str]]) -> list[Row]:
    """One flat row per run: identity, cost, the Pareto fronts it is on, and each metric with protocol and count."""
    return [
        {
            **{key: getattr(run, key) for key in ("family", "group", "work", "name", "method", "settings", "device")},
            "stages": " + ".join(run.stages),
            **run.costs,
            "fronts": " ".join(fronts[run.title]),
            **{key: metric.mean for key, metric in run.metrics.items()},
            **{f"{key}_protocol": metric.protocol for key, metric in run.metrics.items()},
            **{f"{key}_count": metric.count for key, metric in run.metrics.items()},
        }
        for run in runs
    ]


def build_page(
    runs: Sequence[Run], charts: Sequence[Chart], gaps: Sequence[Gap], fronts: Mapping[str, Sequence[str]]
) -> str:
    """The page of a comparison. fronts: "metric/cost" of each Pareto front a run is on, by the run's title."""
    works = ", ".join(dict.fromkeys(run.work for run in runs))
    families = [family for family in FAMILIES if any(run.family == family for run in runs)]
    return render_page(
        "comparison.html",
        works=works,
        summary=f"{len(runs)} runs of {works}, from their manifests and reports.",
        families=[(family, TITLES[family], True) for family in families],
        parts={family: _family(family, runs, charts, fronts) for family in families},
        gaps=gaps,
    )


def _family(family: str, runs: Sequence[Run], charts: Sequence[Chart], fronts: Mapping[str, Sequence[str]]) -> Family:
    runs = [run for run in runs if run.family == family]
    # Labels name networks and protocols, so a metric has one column per label.
    columns = [
        (key, label)
        for key in (*CHARTED[family], *(key for key in BY_KEY if key not in CHARTED[family]))
        for label in dict.fromkeys(run.metrics[key].label for run in runs if key in run.metrics)
    ]
    protocols = protocols_of(runs)
    rows = []
    for run in runs:
        leading = {front.partition("/")[0] for front in fronts[run.title]}
        cells = []
        for key, label in columns:
            metric = run.metrics.get(key)
            if metric is None or metric.label != label:
                cells.append(MetricCell(number(None, 0)))
            else:
                text = number(metric.mean, BY_KEY[key].digits)
                cells.append(MetricCell(text, key in leading, *_mark(metric, protocols[run.group, key])))
        rows.append((run, cells))
    own = [chart for chart in charts if chart.name.startswith(f"{family}_")]
    return Family(TITLES[family], own, [label + _better(BY_KEY[key].better) for key, label in columns], rows)


def _mark(metric: RunMetric, protocols: Sequence[Protocol]) -> tuple[str, str]:
    """A letter for the protocol and its text; both empty if the group has only one."""
    if len(protocols) == 1:
        return "", ""
    letter = LETTERS[protocols.index(metric.comparable_by) % len(LETTERS)]
    return letter, f"{metric.protocol} Views or pairs: {metric.count}."


def _better(better: str) -> str:
    return f" ({better} is better)" if better else ""


def compared(works: Sequence[WorkFolder], out: Path) -> dict[str, Any]:
    """Write compare.json, runs.csv, compare.html and charts/ to `out`; return what compare.json holds.

    Raises:
        ArtifactStale: none of the work folders contains a field.
    """

    with sweeping((out, out / "charts")):
        runs, gaps = runs_of(works)
        if not runs:
            command = shlex.join(["stylerf", "fit", str(works[0].root)])
            raise ArtifactStale(f"no field to compare in {works[0].root}; make one with: {command}")
        fronts: dict[str, list[str]] = {}
        for family in FAMILIES:
            members = [one for one in runs if one.family == family]
            gaps += unlike_machines(members)
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
