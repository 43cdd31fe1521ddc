"""Values of views and pairs brought together to figures with their protocol and spread."""

import csv
import math
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from schemas.atomic_write import replacing
from schemas.safe_names import printable
from stages.evaluation.metric_definitions import KINDS

Row = dict[str, object]  # one view or one pair of views: name and values by key; None where not measured


@dataclass(frozen=True)
class Metric:
    """One figure over its views (or pairs): mean, spread, how many took part, how many had to be left out."""

    key: str
    label: str
    unit: str
    better: str
    digits: int
    protocol: str
    mean: float
    median: float
    min: float
    max: float
    count: int
    left_out: int
    reference: dict[str, float]  # the same figure of something to compare with, such as the unstylized render

    def as_json(self) -> dict:
        """Plain numbers and text."""
        return asdict(self)


class _Facts(dict):
    def __missing__(self, key: str) -> str:
        return f"({key} not recorded)"


def summarize(
    rows: Sequence[Row], facts: Mapping[str, object], references: Mapping[str, Mapping[str, float]] | None = None
) -> list[Metric]:
    """One Figure per kind that any row holds a finite value of, in the order of KINDS.

    A row without a finite value where others have one is left out of the mean and counted as left out.
    """
    found = []
    for kind in KINDS:
        holding = [row for row in rows if kind.key in row]
        values = sorted(float(row[kind.key]) for row in holding if is_number(row[kind.key]))
        if not values:
            continue
        middle = len(values) // 2
        median = values[middle] if len(values) % 2 else (values[middle - 1] + values[middle]) / 2
        filled = _Facts(facts)
        found.append(
            Metric(
                key=kind.key,
                label=kind.label.format_map(filled),
                unit=kind.unit,
                better=kind.better,
                digits=kind.digits,
                protocol=kind.protocol.format_map(filled),
                mean=math.fsum(values) / len(values),
                median=median,
                min=values[0],
                max=values[-1],
                count=len(values),
                left_out=len(holding) - len(values),
                reference={k: float(v) for k, v in (references or {}).get(kind.key, {}).items() if is_number(v)},
            )
        )
    return found


def is_number(value: object) -> bool:
    """A finite number, no truth value and no text."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def write_csv(path: Path, rows: Sequence[Row]) -> None:
    """One line a row under the union of their keys; what was not measured is empty.

    A text that a spreadsheet would take for a formula begins with an apostrophe, which it shows as text.
    """
    keys = list(dict.fromkeys(key for row in rows for key in row))
    with replacing(path) as temporary, open(temporary, "w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, keys, restval="", lineterminator="\n")
        writer.writerow({key: _cell(key) for key in keys})
        writer.writerows([{key: _cell(value) for key, value in row.items()} for row in rows])


def _cell(value: object) -> object:
    if not isinstance(value, str):
        return "" if value is None else value
    # Spaces, tabs and line breaks before a sign are taken away by some programs, full-width signs for plain ones.
    begins = unicodedata.normalize("NFKC", value).lstrip().startswith(("=", "+", "-", "@"))
    return f"'{printable(value)}" if begins else printable(value)
