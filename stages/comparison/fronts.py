"""Which runs are on a Pareto front, and where figures were measured by protocols that do not agree."""

from collections.abc import Sequence
from dataclasses import dataclass

from stages.comparison.runs import COSTS, Gap, Run
from stylerf.metrics.pareto import pareto_front

Front = list[Run]  # the cheapest first
LEAST_SHARE = 0.1  # of its pixels: what fewer tell of a consistency is no ground to rank by


@dataclass(frozen=True)
class Panel:
    """One figure of one family against one cost: the runs that have both, and their fronts by group and protocol."""

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
    sets: dict[tuple[str, str], list[Run]] = {}
    for run in having:
        if _too_few(run, key):
            continue
        sets.setdefault((run.group, run.figures[key].protocol), []).append(run)
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


def disagreements(runs: Sequence[Run], keys: Sequence[str]) -> list[Gap]:
    """Figures of one group that were measured by more than one protocol, and so share no front; and those of too few
    pixels for any."""
    found = []
    for key in keys:
        protocols: dict[str, set[str]] = {}
        for run in runs:
            if key in run.figures:
                protocols.setdefault(run.group, set()).add(run.figures[key].protocol)
        found += [
            Gap(
                f"{run.title}: {key}",
                f"Told by {_share(run, key):.1%} of the pixels alone, a front asks for {LEAST_SHARE:.0%}.",
            )
            for run in runs
            if key in run.figures and _too_few(run, key)
        ]
        found += [
            Gap(f"{group}: {key}", f"Measured by {len(some)} protocols; only runs of the same one share a front.")
            for group, some in protocols.items()
            if len(some) > 1
        ]
    return found


def _share(run: Run, key: str) -> float | None:
    """Of its pixels, that a figure is the mean over, where its report tells that."""
    share = run.figures.get(f"{key.rpartition('_')[0]}_share")
    return share.mean if share else None


def _too_few(run: Run, key: str) -> bool:
    share = _share(run, key)
    return share is not None and share < LEAST_SHARE
