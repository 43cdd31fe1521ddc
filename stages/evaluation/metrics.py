"""Summarize values of views and pairs as metrics with protocol and spread; write them as CSV."""

import csv
import math
import sys
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeGuard

from schemas.atomic_write import replacing
from schemas.safe_names import printable
from stages.evaluation.metric_definitions import DEFINITIONS, MetricDefinition

Row = dict[str, object]  # a view or a pair of views: its name, and values by metric key; None if not measured


@dataclass(frozen=True)
class Metric(MetricDefinition):
    """A metric over views or pairs: mean, spread, how many have it and how many had to be left out."""

    mean: float
    median: float
    min: float
    max: float
    count: int
    left_out: int
    reference: dict[str, float]  # the same metric of something to compare with, such as the unstylized renders


class _Facts(dict):
    def __missing__(self, key: str) -> str:
        return f"({key} not recorded)"


def summarize(
    rows: Sequence[Row], facts: Mapping[str, object], references: Mapping[str, Mapping[str, float]] | None = None
) -> list[Metric]:
    """Average every metric that any row has a finite value of, in the order of DEFINITIONS.

    Args:
        facts: what fills in labels and protocols.
        references: means of something to compare with, as {metric key: {name: mean}}.

    Returns:
        One Metric per key; rows that have the key without a finite value are not in the mean but in `left_out`.
    """
    found = []
    for definition in DEFINITIONS:
        having = [row for row in rows if definition.key in row]
        values = sorted(value for row in having if (value := number_in(row, definition.key)) is not None)
        if not values:
            continue
        middle = len(values) // 2
        median = values[middle] if len(values) % 2 else (values[middle - 1] + values[middle]) / 2
        found.append(
            Metric(
                **vars(definition)
                | {name: getattr(definition, name).format_map(_Facts(facts)) for name in ("label", "protocol")},
                mean=math.fsum(values) / len(values),
                median=median,
                min=values[0],
                max=values[-1],
                count=len(values),
                left_out=len(having) - len(values),
                reference={k: float(v) for k, v in (references or {}).get(definition.key, {}).items() if is_number(v)},
            )
        )
    return found


def is_number(value: object) -> TypeGuard[float]:
    """Whether the value is a finite int or float, not a bool."""
    if not isinstance(value, (int, float)) or isinstance(value, bool):
        return False
    return -sys.float_info.max <= value <= sys.float_info.max  # math.isfinite() fails on larger integers


def number_in(row: Row, key: str) -> float | None:
    """The finite number that a row has under a key, if any."""
    value = row.get(key)
    return float(value) if is_number(value) else None


def write_csv(path: Path, rows: Sequence[Row]) -> None:
    """Write one line per row under the union of their keys; missing values are empty.

    Text that a spreadsheet would take for a formula gets a leading apostrophe.
    """
    keys = list(dict.fromkeys(key for row in rows for key in row))
    with replacing(path) as temporary, open(temporary, "w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, keys, restval="", lineterminator="\n")
        writer.writerow({key: _cell(key) for key in keys})
        writer.writerows([{key: _cell(value) for key, value in row.items()} for row in rows])


def _cell(value: object) -> object:
    if not isinstance(value, str):
        return "" if value is None else value
    # Some programs strip white space before a sign, and read full-width signs as plain ones.
    formula = unicodedata.normalize("NFKC", value).lstrip().startswith(("=", "+", "-", "@"))
    return f"'{printable(value)}" if formula else printable(value)
