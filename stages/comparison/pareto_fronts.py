"""Pareto fronts of runs, and metrics that cannot be compared because their protocols differ."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from stages.comparison.runs import COSTS, Gap, Protocol, Run
from stylerf.metrics.pareto import pareto_front

Front = list[Run]  # cheapest first
MIN_COVERAGE = 0.1  # of the pixels: consistency over fewer is not ranked


@dataclass(frozen=True)
class Panel:
    """One metric against one cost: the runs that have both, and their fronts by group and protocol."""

    key: str
    cost: str
    label: str
    unit: str
    better: str
    runs: list[Run]
    fronts: list[Front]

    def at(self, run: Run) -> tuple[float, float]:
        """Cost (NaN if unknown) and metric of a run."""
        cost = run.costs[self.cost]
        return math.nan if cost is None else float(cost), run.metrics[self.key].mean


def panel_of(runs: Sequence[Run], key: str, cost: str) -> Panel | None:
    """Plot a metric against a cost; None if no run has both. Different devices share no front of times or memory."""
    having = [run for run in runs if key in run.metrics and run.costs[cost] is not None]
    if not having:
        return None
    first = having[0].metrics[key]
    comparable: dict[tuple[str, Protocol, str], list[Run]] = {}
    for run in having:
        if not why_excluded(run, key):
            device = "" if cost == "parameters" else run.device
            comparable.setdefault((run.group, run.metrics[key].comparable_by, device), []).append(run)
    panel = Panel(key, cost, first.label, first.unit, first.better, having, [])
    for members in comparable.values() if first.better else ():
        costs, means = zip(*map(panel.at, members), strict=True)
        panel.fronts.append([members[i] for i in pareto_front(costs, means, first.better == "higher")])
    return panel


def on_fronts(runs: Sequence[Run], keys: Sequence[str]) -> dict[str, list[str]]:
    """By title of a run: "metric/cost" of each front it is on."""
    found: dict[str, list[str]] = {run.title: [] for run in runs}
    for key in keys:
        for cost in COSTS:
            panel = panel_of(runs, key, cost)
            for front in panel.fronts if panel else ():
                for run in front:
                    found[run.title].append(f"{key}/{cost}")
    return found


def disagreements(runs: Sequence[Run], charted: Sequence[str]) -> list[Gap]:
    """Metrics that cannot be compared within a group because their protocols differ, and charted ones on no front."""
    found = [
        Gap(f"{run.title}: {key}", why)
        for key in charted
        for run in runs
        if key in run.metrics and (why := why_excluded(run, key))
    ]
    for (group, key), protocols in protocols_of(runs).items():
        texts = len({text for text, _ in protocols})
        if texts > 1:
            why = f"Measured by {texts} protocols; only runs with the same protocol share a front."
        elif len(protocols) > 1:
            counts = " and ".join(str(count) for count in sorted(count for _, count in protocols))
            why = f"Measured over {counts} views or pairs; only runs with the same number share a front."
        else:
            continue
        found.append(Gap(f"{group}: {key}", why))
    return found


def protocols_of(runs: Sequence[Run]) -> dict[tuple[str, str], list[Protocol]]:
    """By group and metric, the different protocols with their counts, in the order of the runs."""
    found: dict[tuple[str, str], dict[Protocol, None]] = {}
    for run in runs:
        for key, metric in run.metrics.items():
            found.setdefault((run.group, key), {})[metric.comparable_by] = None
    return {group_and_key: list(protocols) for group_and_key, protocols in found.items()}


def why_excluded(run: Run, key: str) -> str:
    """Return why a metric of a run cannot be on any front; empty if it can."""
    metric, coverage = run.metrics[key], run.metrics.get(f"{key.rpartition('_')[0]}_share")
    if metric.left_out:
        return f"{metric.left_out} of {metric.count + metric.left_out} views or pairs could not be measured."
    if coverage is not None and coverage.mean < MIN_COVERAGE:
        return f"Measured on only {coverage.mean:.1%} of the pixels; a front needs {MIN_COVERAGE:.0%}."
    return ""
