"""The comparison as one self-contained HTML page, and as a table for other programs."""

from collections.abc import Mapping, Sequence
from html import escape

from stages.comparison.charts import TITLES
from stages.comparison.runs import CHARTED, EDITS, FITS, STYLISATIONS, Gap, Run
from stages.evaluation.charts import Chart
from stages.evaluation.figures import Row
from stages.evaluation.kinds import BY_KEY
from stages.evaluation.page_style import CSS
from stages.evaluation.page_tables import table
from stages.evaluation.wording import count, duration, megabytes, number

FAMILIES = (FITS, STYLISATIONS, EDITS)


def rows_of(runs: Sequence[Run], fronts: Mapping[str, Sequence[str]]) -> list[Row]:
    """One flat row a run: what it is, its costs, all its figures by key, and the fronts that it is on."""
    return [
        {
            **{key: getattr(run, key) for key in ("family", "group", "work", "name", "method", "settings", "device")},
            "stages": " + ".join(run.stages),
            **run.costs,
            "fronts": " ".join(fronts[run.title]),
            **{key: measure.mean for key, measure in run.figures.items()},
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
    "<p>A run is on a Pareto front where no other run of the same group, measured by the same protocol, is as good for "
    "less or better for as much. A group is a scene, for stylisations with one painting, for edits with one set of "
    "regions or masks, known by their content. Time is wall time of all attempts: of a fit its own; of a stylisation "
    "or an edit that of every stage since the fitted field, selection and rendering left out. Memory is the greatest "
    "of these stages’ processes.</p>"
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
    known = [key for key in BY_KEY if any(key in run.figures for run in runs)]
    keys = [*(key for key in CHARTED[family] if key in known), *(key for key in known if key not in CHARTED[family])]
    labels = {key: next(run.figures[key] for run in runs if key in run.figures) for key in keys}
    heads = ["Run", "Group", "Method", "Settings", "Stages", "Device", "Time", "Peak memory", "Parameters"]
    heads += [f"{labels[key].label}{_better(labels[key].better)}" for key in keys]
    rows = []
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
        for key in keys:
            value = number(run.figures[key].mean if key in run.figures else None, BY_KEY[key].digits)
            on = ' mean" title="on a Pareto front' if key in leading else ""
            cells += f'<td class="number{on}">{value}</td>'
        rows.append(f'<tr><th scope="row">{escape(run.title)}</th>{cells}</tr>')
    caption = "Every run; bold figures are on a Pareto front against time, memory or parameters; – : not measured"
    return table(f"{TITLES[family]}, all runs", caption, heads, range(6, 9 + len(keys)), rows, "dense")


def _better(better: str) -> str:
    return f" ({better} is better)" if better else ""


def _missing(gaps: Sequence[Gap]) -> str:
    if not gaps:
        return "<p>Nothing: every run tells its costs and was measured.</p>"
    items = "".join(f"<dt>{escape(gap.what)}</dt><dd>{escape(gap.why)}</dd>" for gap in gaps)
    return f'<dl class="notes">{items}</dl>'
