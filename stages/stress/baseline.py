"""Baselines: the cells of an earlier run, to notice regressions."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from schemas.atomic_write import write_json
from schemas.errors import BadInput, UsageError
from schemas.safe_reading import read_json
from stages.configs.faults import METHODS
from stages.evaluation.metrics import is_number
from stages.stress.outcomes import REMEDIED, Cell

SCHEMA = 1
# Differences that another machine may cause; dB for fits, shares for the others.
TOLERANCE = {"fits": 0.5, "stylizations": 0.03, "edits": 0.03}
SPREADS = 2.0  # standard errors of the difference beyond which a lower median is not due to chance
# Conditions of methods that take a style image. Empty without any; then no common cell depends on them.
OF_PAINTINGS = ("features", "paintings")


@dataclass(frozen=True)
class Compared:
    """The comparison with a baseline: lines of text by cell.

    matched: number of cells that both have, with as many runs. unmatched: the other cells.
    """

    worse: list[str]
    better: list[str]
    unmatched: list[str]
    matched: int


def write_baseline(path: Path, cells: Sequence[Cell], conditions: dict) -> None:
    """Replace the file; UsageError if a cell lacks runs, since the others may be due to chance."""
    for cell in cells:
        if cell.count != conditions["seeds"]:
            raise UsageError(
                f"no baseline written to {path}: {cell.method} under {cell.fault} has {cell.count} of "
                f"{conditions['seeds']} runs; rerun without --only, or leave out that fault"
            )
    kept = [
        {key: getattr(cell, key) for key in ("method", "fault", "successes", "count", "median", "spread")}
        for cell in cells
    ]
    write_json(path, {"schema": SCHEMA, "conditions": conditions, "cells": kept})


def read_baseline(path: Path, conditions: dict) -> list[dict]:
    """Return the cells; BadInput if the file cannot be read, UsageError if its conditions differ."""
    try:
        content = read_json(path)
        if content["schema"] != SCHEMA:
            raise BadInput(f"--baseline {path} has schema {content['schema']}, expected {SCHEMA}; write a new one")
        cells, made = _checked(content)
    except FileNotFoundError as error:
        raise BadInput(
            f"--baseline {path} cannot be read ({error.strerror}); --write-baseline {path} makes one"
        ) from error
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        raise BadInput(f"--baseline {path} is not a baseline ({error!r}); --write-baseline {path} makes one") from error
    differing = [
        key
        for key in {**made, **conditions}
        if made.get(key) != conditions.get(key)
        and not (key in OF_PAINTINGS and "" in (made.get(key), conditions.get(key)))
    ]
    if differing:
        differences = ", ".join(
            f"{key} {made[key]!r}, now {conditions.get(key)!r}" if key in made else f"{key} missing"
            for key in sorted(differing)
        )
        raise UsageError(
            f"--baseline {path} was made under other conditions: {differences}; use the same, or write a new one"
        )
    return cells


def _checked(content: dict) -> tuple[list[dict], dict]:
    """Return cells and conditions; ValueError, KeyError or TypeError if `write_baseline` did not write them."""
    cells, made = content["cells"], content["conditions"]
    if not isinstance(cells, list) or not isinstance(made, dict):
        raise ValueError("cells are a list, conditions an object")
    for cell in cells:
        if not (isinstance(cell["method"], str) and isinstance(cell["fault"], str)):
            raise ValueError(f"a cell of {cell['method']!r} under {cell['fault']!r}")
        counts = cell["successes"], cell["count"]
        if not (all(isinstance(one, int) for one in counts) and 0 <= counts[0] <= counts[1] and counts[1] > 0):
            raise ValueError(f"{counts[0]!r} of {counts[1]!r} runs")
        if wrong := [one for one in (cell["median"], cell["spread"]) if one is not None and not is_number(one)]:
            raise ValueError(f"{wrong[0]!r} is not a score")
    return cells, made


def compared(before: Sequence[dict], cells: Sequence[Cell]) -> Compared:
    """Compare cells with those of a baseline.

    A cell is worse if fewer of its runs succeed, or if its median score is missing or falls by more than chance
    explains: the tolerance of its family or SPREADS standard errors of the difference, whichever is more. Cells with
    different numbers of runs are not compared.
    """
    earlier = {(one["method"], one["fault"]): one for one in before}
    now = {(cell.method, cell.fault): cell for cell in cells}
    worse: list[str] = []
    better: list[str] = []
    both = [key for key in now if key in earlier]
    matched = [key for key in both if now[key].count == earlier[key]["count"]]
    for key in matched:
        change, words = _change(earlier[key], now[key])
        if change:
            (worse if change < 0 else better).append(words)
    lone = [f"{method} under {fault}: only in the baseline" for method, fault in earlier if (method, fault) not in now]
    lone += [f"{method} under {fault}: not in the baseline" for method, fault in now if (method, fault) not in earlier]
    lone += [
        f"{' under '.join(key)}: number of runs {now[key].count}, was {earlier[key]['count']}"
        for key in both
        if key not in matched
    ]
    return Compared(worse, better, lone, len(matched))


def _change(before: dict, cell: Cell) -> tuple[int, str]:
    """Return -1, 0 or 1, and a description of the change."""
    where = f"{cell.method} under {cell.fault}"
    rate = before["successes"] / before["count"]
    if cell.rate != rate:
        words = f"{where}: {cell.successes} of {cell.count} succeed, {before['successes']} of {before['count']} did"
        return (-1 if cell.rate < rate else 1), words
    was, now = before["median"], cell.median
    if was is None or now is None:
        return (now is not None) - (was is not None), f"{where}: median score {_formatted(now)}, was {_formatted(was)}"
    family = METHODS[cell.method.removesuffix(REMEDIED)].family
    error = math.hypot(before["spread"] or 0.0, cell.spread or 0.0) / math.sqrt(cell.count)
    change = now - was
    if abs(change) <= max(TOLERANCE[family], SPREADS * error):
        return 0, ""
    return (1 if change > 0 else -1), f"{where}: median score {_formatted(now)}, was {_formatted(was)}"


def _formatted(median: float | None) -> str:
    return "missing" if median is None else f"{median:.3f}"
