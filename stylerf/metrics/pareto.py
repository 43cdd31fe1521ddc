"""Which of several runs are not beaten: the Pareto front of a cost and a figure."""

from collections.abc import Sequence

from stylerf.errors import InvalidValue


def pareto_front(costs: Sequence[float], figures: Sequence[float], higher: bool) -> list[int]:
    """Indices, the cheapest first, of the runs that no other beats.

    A run is beaten by one that costs no more and has a figure no worse, and is better in one of the two; of equal runs
    none beats another. higher: whether a higher figure is better; a lower cost always is.
    """
    if len(costs) != len(figures):
        raise InvalidValue(f"as many costs as figures were expected, got {len(costs)} and {len(figures)}")
    sign = -1.0 if higher else 1.0
    order = sorted(range(len(costs)), key=lambda i: (costs[i], sign * figures[i]))
    front: list[int] = []
    for i in order:
        best = sign * figures[front[-1]] if front else float("inf")
        same = bool(front) and (costs[i], figures[i]) == (costs[front[-1]], figures[front[-1]])
        if sign * figures[i] < best or same:
            front.append(i)
    return front
