"""The HTML page of a comparison, and its rows for CSV."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from stages.comparison.cost_charts import TITLES
from stages.comparison.pareto_fronts import protocols_of
from stages.comparison.runs import CHARTED, EDITS, FITS, STYLIZATIONS, Gap, Protocol, Run, RunMetric
from stages.evaluation.metric_definitions import BY_KEY
from stages.evaluation.metrics import Row
from stages.report.charts import Chart
from stages.report.formatting import number
from stages.report.pages import render_page

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
