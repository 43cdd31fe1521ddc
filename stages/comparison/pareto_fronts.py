"""Which runs are on a Pareto front, and where figures were measured by protocols that do not agree."""

from collections.abc import Sequence
from dataclasses import dataclass

from stages.comparison.runs import COSTS, Gap, Run
from stylerf.metrics.pareto import pareto_front

Front = list[Run]  # the cheapest first
LEAST_SHARE = 0.1  # of its pixels: what fewer tell of a consistency is no ground to rank by


@dataclass(frozen=True)
class Panel:
    """One figure of one family against one cost: the runs that have both, and their fronts by group and way of
    measuring."""

    key: str
    cost: str
    label: str
    unit: str
    better: str
    runs: list[Run]
    fronts: list[Front]

    def at(self, run: Run) -> tuple[float, float]:
        """Cost and figure of a run."""
        return float(run.costs[self.cost]), run.figures[self.key].mean


def panel_of(runs: Sequence[Run], key: str, cost: str) -> Panel | None:
    """None where no run has both."""
    having = [run for run in runs if key in run.figures and run.costs[cost] is not None]
    if not having:
        return None
    first = having[0].figures[key]
    sets: dict[tuple[str, tuple[str, int]], list[Run]] = {}
    for run in having:
        if not why_off(run, key):
            sets.setdefault((run.group, run.figures[key].way), []).append(run)
    fronts = []
    for some in sets.values() if first.better else ():
        costs, means = [float(run.costs[cost]) for run in some], [run.figures[key].mean for run in some]
        fronts.append([some[i] for i in pareto_front(costs, means, first.better == "higher")])
    return Panel(key, cost, first.label, first.unit, first.better, having, fronts)


def on_fronts(runs: Sequence[Run], keys: Sequence[str]) -> dict[str, list[str]]:
    """By title of a run: "figure/cost" of each front that it is on."""
    found: dict[str, list[str]] = {run.title: [] for run in runs}
    for key in keys:
        for cost in COSTS:
            panel = panel_of(runs, key, cost)
            for front in panel.fronts if panel else ():
                for run in front:
                    found[run.title].append(f"{key}/{cost}")
    return found


def disagreements(runs: Sequence[Run], charted: Sequence[str]) -> list[Gap]:
    """Figures of one group that were measured in more than one way, and so cannot be set beside one another; and which
    of those that are charted no front can take."""
    found = [
        Gap(f"{run.title}: {key}", why)
        for key in charted
        for run in runs
        if key in run.figures and (why := why_off(run, key))
    ]
    for (group, key), ways in ways_of(runs).items():
        protocols = len({protocol for protocol, _ in ways})
        if protocols > 1:
            why = f"Measured by {protocols} protocols; only runs of the same one share a front."
        elif len(ways) > 1:
            counts = " and ".join(str(count) for count in sorted(count for _, count in ways))
            why = f"Over {counts} views or pairs; only runs of the same ones share a front."
        else:
            continue
        found.append(Gap(f"{group}: {key}", why))
    return found


def ways_of(runs: Sequence[Run]) -> dict[tuple[str, str], list[tuple[str, int]]]:
    """By group and key, the ways in which a figure was measured there, in the order of the runs."""
    found: dict[tuple[str, str], dict[tuple[str, int], None]] = {}
    for run in runs:
        for key, measure in run.figures.items():
            found.setdefault((run.group, key), {})[measure.way] = None
    return {where: list(ways) for where, ways in found.items()}


def why_off(run: Run, key: str) -> str:
    """Why a figure of a run is on no front whatever the others are; empty where it may be."""
    measure, share = run.figures[key], run.figures.get(f"{key.rpartition('_')[0]}_share")
    if measure.left_out:
        return f"Of {measure.count + measure.left_out} views or pairs {measure.left_out} could not be measured."
    if share is not None and share.mean < LEAST_SHARE:
        return f"Told by {share.mean:.1%} of the pixels alone, a front asks for {LEAST_SHARE:.0%}."
    return ""
