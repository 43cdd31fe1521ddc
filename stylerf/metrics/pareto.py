"""The Pareto front of a cost and a quality metric."""

from collections.abc import Sequence

from stylerf.errors import InvalidValue


def pareto_front(costs: Sequence[float], metrics: Sequence[float], higher: bool) -> list[int]:
    """Return the indices of all Pareto-optimal runs, cheapest first.

    A run is dominated by one that is no worse in both cost and metric and better in one of them. Equal runs do not
    dominate each other.

    Args:
        costs: Lower is better.
        metrics: One per cost.
    """
    if len(costs) != len(metrics):
        raise InvalidValue(f"expected as many costs as metrics, got {len(costs)} and {len(metrics)}")
    sign = -1.0 if higher else 1.0
    order = sorted(range(len(costs)), key=lambda i: (costs[i], sign * metrics[i]))
    front: list[int] = []
    for i in order:
        # By ascending cost, the last on the front has the best metric so far; a run that is not better is dominated.
        best = sign * metrics[front[-1]] if front else float("inf")
        same = bool(front) and (costs[i], metrics[i]) == (costs[front[-1]], metrics[front[-1]])
        if sign * metrics[i] < best or same:
            front.append(i)
    return front
