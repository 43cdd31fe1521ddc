"""The comparison as one self-contained HTML page, and as a table for other programs."""

from collections.abc import Mapping, Sequence

from stages.comparison.cost_charts import TITLES
from stages.comparison.pareto_fronts import ways_of
from stages.comparison.runs import CHARTED, EDITS, FITS, STYLIZATIONS, Gap, Measure, Run
from stages.evaluation.metric_definitions import BY_KEY
from stages.evaluation.metrics import Row
from stages.report.charts import Chart
from stages.report.formatting import count, duration, escape, megabytes, number
from stages.report.stylesheet import CSS
from stages.report.tables import table

FAMILIES = (FITS, STYLIZATIONS, EDITS)
LETTERS = "abcdefghijklmnopqrstuvwxyz"


def rows_of(runs: Sequence[Run], fronts: Mapping[str, Sequence[str]]) -> list[Row]:
    """One flat row a run: what it is, its costs, all its figures by key with their protocols and numbers of views or
    pairs, and the fronts that it is on."""
    return [
        {
            **{key: getattr(run, key) for key in ("family", "group", "work", "name", "method", "settings", "device")},
            "stages": " + ".join(run.stages),
            **run.costs,
            "fronts": " ".join(fronts[run.title]),
            **{key: measure.mean for key, measure in run.figures.items()},
            **{f"{key}_protocol": measure.protocol for key, measure in run.figures.items()},
            **{f"{key}_count": measure.count for key, measure in run.figures.items()},
        }
        for run in runs
    ]


def build_page(
    runs: Sequence[Run], charts: Sequence[Chart], gaps: Sequence[Gap], fronts: Mapping[str, Sequence[str]]
) -> str:
    """HTML 5, UTF-8; no script, nothing fetched from elsewhere."""
    works = list(dict.fromkeys(run.work for run in runs))
    sections = [(family, TITLES[family], _family(family, runs, charts, fronts)) for family in FAMILIES]
    sections = [
        *(one for one in sections if one[2]),
        ("missing", "What is missing, and why", _missing(gaps)),
        ("how", "How to read it", _HOW),
    ]
    links = "".join(f'<li><a href="#{key}">{escape(heading)}</a></li>' for key, heading, _ in sections)
    body = "".join(
        f'<section id="{key}" aria-labelledby="{key}-heading"><h2 id="{key}-heading">{escape(heading)}</h2>{content}'
        "</section>"
        for key, heading, content in sections
    )
    told = f"{len(runs)} runs of {', '.join(works)}, as their manifests and reports tell them."
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f'<title>Comparison: {escape(", ".join(works))}</title><link rel="icon" href="data:,"><style>{CSS}</style>'
        '</head><body><a class="skip" href="#content">Skip to the content</a>'
        f'<header><div><h1>Comparison</h1><p class="soft">{escape(told)}</p><nav aria-label="Sections"><ul>{links}</ul>'
        f'</nav></div></header><main id="content">{body}</main><footer><p>Written by stylerf compare. The same '
        "figures are in runs.csv and compare.json, the charts in the folder charts, all beside this page.</p></footer>"
        "</body></html>\n"
    )


_HOW = (
    "<p>A run is on a Pareto front where no other run of the same group, measured by the same protocol over as many "
    "views or pairs, none left out, is as good for less or better for as much. A group is a scene, for stylizations "
    "with one painting, for edits with one set of regions or masks, known by their content. Time is wall time of all "
    "attempts: of a fit its own; of a stylization or an edit that of every stage since the fitted field, selection and "
    "rendering left out. Memory is the greatest of these stages’ processes. A figure is that of the newest evaluation "
    "of the field that holds it.</p>"
)


def _family(family: str, runs: Sequence[Run], charts: Sequence[Chart], fronts: Mapping[str, Sequence[str]]) -> str:
    some = [run for run in runs if run.family == family]
    if not some:
        return ""
    drawn = "".join(
        f'<section class="chart"><h3>{escape(chart.title)}</h3><figure>{chart.inline()}'
        f"<figcaption>{escape(chart.told)}.</figcaption></figure></section>"
        for chart in charts
        if chart.name.startswith(f"{family}_")
    )
    return drawn + _runs_table(family, some, fronts)


def _runs_table(family: str, runs: Sequence[Run], fronts: Mapping[str, Sequence[str]]) -> str:
    # Networks stand in the labels: what others measured has a column of its own.
    columns = [
        (key, label)
        for key in (*CHARTED[family], *(key for key in BY_KEY if key not in CHARTED[family]))
        for label in dict.fromkeys(run.figures[key].label for run in runs if key in run.figures)
    ]
    heads = ["Run", "Group", "Method", "Settings", "Stages", "Device", "Time", "Peak memory", "Parameters"]
    heads += [f"{label}{_better(BY_KEY[key].better)}" for key, label in columns]
    ways, rows = ways_of(runs), []
    for run in runs:
        words = (run.group, run.method, run.settings, " + ".join(run.stages), run.device)
        costs = (
            duration(run.costs["seconds"]),
            megabytes(run.costs["peak_memory_mb"]),
            count(run.costs["parameters"]),
        )
        cells = "".join(f"<td>{escape(text)}</td>" for text in words)
        cells += "".join(f'<td class="number">{text}</td>' for text in costs)
        leading = {one.partition("/")[0] for one in fronts[run.title]}
        for key, label in columns:
            measure = run.figures.get(key)
            measure = measure if measure and measure.label == label else None
            value = number(measure.mean if measure else None, BY_KEY[key].digits)
            on = ' mean" title="on a Pareto front' if measure and key in leading else ""
            mark = _mark(measure, ways[run.group, key]) if measure else ""
            cells += f'<td class="number{on}">{value}{mark}</td>'
        rows.append(f'<tr><th scope="row">{escape(run.title)}</th>{cells}</tr>')
    caption = (
        "Every run; bold figures are on a Pareto front against time, memory or parameters; – : not measured; a small "
        "letter: within its group measured in more than one way, one letter each"
    )
    return table(f"{TITLES[family]}, all runs", caption, heads, range(6, 9 + len(columns)), rows, "dense")


def _mark(measure: Measure, ways: Sequence[tuple[str, int]]) -> str:
    """Which of the ways of its group a figure was measured in; empty where there is one."""
    if len(ways) == 1:
        return ""
    told = f"{measure.protocol} Views or pairs: {measure.count}."
    return f'<sup title="{escape(told)}">{LETTERS[ways.index(measure.way) % len(LETTERS)]}</sup>'


def _better(better: str) -> str:
    return f" ({better} is better)" if better else ""


def _missing(gaps: Sequence[Gap]) -> str:
    if not gaps:
        return "<p>Nothing: every run tells its costs and was measured.</p>"
    items = "".join(f"<dt>{escape(gap.what)}</dt><dd>{escape(gap.why)}</dd>" for gap in gaps)
    return f'<dl class="notes">{items}</dl>'
