"""Figures of a table: mean and spread over seeds of stylizations and of edits; ranks; Pareto fronts."""

import statistics
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from stages.comparison.pareto_fronts import why_excluded
from stages.comparison.runs import Run
from stages.farm.jobs import Axes
from stylerf.metrics.pareto import pareto_front

# Style, by a network that no method matched; structure; consistency; then the cost.
COLUMNS = ("sifid", "judge_gram", "edges_kept", "short_rmse", "long_rmse", "seconds", "peak_memory_mb")
# For local edits: what changed, what should not have, consistency; then cost. All edits of a scene share one block.
EDIT_COLUMNS = (
    "change_lab", "background_ratio", "bleeding", "edit_short_rmse", "edit_long_rmse", "seconds", "peak_memory_mb",
)  # fmt: skip
COSTS = {"seconds": ("Time", "s", "lower", 0), "peak_memory_mb": ("Peak memory", "MB", "lower", 0)}
# Consistency and structure are shown only against style, since blur is consistent.
STYLE, AGAINST = "sifid", ("seconds", "edges_kept", "short_rmse", "long_rmse")
Block = tuple[str, str]  # scene and style; no style for edits


@dataclass(frozen=True)
class Value:
    """Mean and sample standard deviation (1/(n-1)) of `count` values; a single value has no spread."""

    mean: float
    spread: float | None
    count: int


@dataclass(frozen=True)
class Cell:
    """One scene, style and method, or one scene and edit: values over seeds by column.

    style: empty for an edit, whose name is the method.
    protocols: of the metrics: values compare only within one.
    """

    scene: str
    style: str
    method: str
    seeds: tuple[int, ...]
    values: Mapping[str, Value]
    protocols: Mapping[str, tuple[str, int]]

    @property
    def block(self) -> Block:
        """The block within which methods are ranked."""
        return self.scene, self.style


@dataclass(frozen=True)
class Standing:
    """A method over the blocks in which every method of the table has the column.

    Attributes:
        rank: mean rank, 1 for the best; equal means share the mean of their ranks.
        relative: mean of its value divided by the mean over methods, block by block.
        spread: mean over its cells of the standard deviation over seeds, divided likewise; None for single seeds.
        blocks: how many there are.
    """

    method: str
    column: str
    rank: float
    relative: float
    spread: float | None
    blocks: int


def value_of(values: Sequence[float]) -> Value:
    """Return mean and spread."""
    return Value(statistics.fmean(values), statistics.stdev(values) if len(values) > 1 else None, len(values))


def cells_of(runs: Sequence[tuple[Run, Axes]], columns: Sequence[str] = COLUMNS) -> list[Cell]:
    """Return a cell for each scene, style and method, in the order of the runs.

    A metric is averaged over the seeds that share the protocol of the first; those that miss views are left out.
    """
    groups: dict[tuple[str, str, str], list[tuple[Run, Axes]]] = defaultdict(list)
    for run, axes in runs:
        groups[axes.scene, axes.style, axes.method].append((run, axes))
    return [_cell(*key, members, columns) for key, members in groups.items()]


def _cell(
    scene: str, style: str, method: str, members: Sequence[tuple[Run, Axes]], columns: Sequence[str]
) -> Cell:
    values, protocols = {}, {}
    for column in columns:
        if column in COSTS:
            found = [cost for run, _ in members if (cost := run.costs.get(column)) is not None]
        else:
            having = [run.metrics[column] for run, _ in members
                      if column in run.metrics and not why_excluded(run, column)]  # fmt: skip
            found = [one.mean for one in having if one.comparable_by == having[0].comparable_by]
            if having:
                protocols[column] = having[0].comparable_by
        if found:
            values[column] = value_of(found)
    return Cell(scene, style, method, tuple(axes.seed for _, axes in members), values, protocols)


def better_of(runs: Sequence[Run], column: str) -> str:
    """Return "lower" or "higher"."""
    if column in COSTS:
        return COSTS[column][2]
    return next((run.metrics[column].better for run in runs if column in run.metrics), "")


def standings_of(cells: Sequence[Cell], better: Mapping[str, str]) -> list[Standing]:
    """Rank the methods by each column that has a better direction, over the blocks in which all can be compared."""
    methods = list(dict.fromkeys(cell.method for cell in cells))
    found = []
    for column, end in better.items():
        blocks = _complete_blocks(cells, column, methods) if end else []
        places: dict[str, list[tuple[float, float, float | None]]] = defaultdict(list)
        for block in blocks:
            means = {cell.method: cell.values[column].mean for cell in block}
            middle = statistics.fmean(means.values())
            for cell in block:
                value = cell.values[column]
                rank = _rank(value.mean, list(means.values()), end == "higher")
                scale = middle or 1.0
                spread = None if value.spread is None else value.spread / scale
                places[cell.method].append((rank, value.mean / scale if middle else 1.0, spread))
        for method, rows in places.items():
            spreads = [spread for *_, spread in rows if spread is not None]
            found.append(
                Standing(
                    method, column, statistics.fmean(rank for rank, *_ in rows),
                    statistics.fmean(relative for _, relative, _ in rows),
                    statistics.fmean(spreads) if spreads else None, len(rows),
                )
            )  # fmt: skip
    return found


def _complete_blocks(cells: Sequence[Cell], column: str, methods: Sequence[str]) -> list[list[Cell]]:
    by_block: dict[Block, list[Cell]] = defaultdict(list)
    for cell in cells:
        if column in cell.values:
            by_block[cell.block].append(cell)
    return [
        block
        for block in by_block.values()
        if len(block) == len(methods) and len({cell.protocols.get(column) for cell in block}) == 1
    ]


def _rank(value: float, values: Sequence[float], higher: bool) -> float:
    ahead = sum(one > value if higher else one < value for one in values)
    return ahead + (values.count(value) + 1) / 2


@dataclass(frozen=True)
class Front:
    """Methods by style and one other column, over the blocks in which both can be compared.

    points: of each method, the column's value and the style distance, relative to the mean over methods. best: the
    methods on the Pareto front.
    """

    points: Mapping[str, tuple[float, float]]
    best: tuple[str, ...]


def fronts_of(cells: Sequence[Cell], better: Mapping[str, str]) -> dict[str, Front]:
    """Return the Pareto front of style against each other column, by that column."""
    methods = list(dict.fromkeys(cell.method for cell in cells))
    by_style = {block[0].block for block in _complete_blocks(cells, STYLE, methods)}
    found = {}
    for column in AGAINST:
        shared = by_style & {block[0].block for block in _complete_blocks(cells, column, methods)}
        ends = {name: better[name] for name in (STYLE, column)}
        standings = standings_of([cell for cell in cells if cell.block in shared], ends)
        at = {(one.method, one.column): one.relative for one in standings}
        points = {method: (at[method, column], at[method, STYLE]) for method in methods if (method, column) in at}
        sign = -1.0 if better[column] == "higher" else 1.0  # the front expects costs, where less is better
        front = pareto_front([sign * x for x, _ in points.values()], [y for _, y in points.values()], False)
        if points:
            found[column] = Front(points, tuple([*points][index] for index in front))
    return found
