"""Numbers from files of other tools: checked to be finite and of the expected count, or reported with their
location."""

import math

import numpy as np

from schemas.errors import BadInput
from schemas.safe_names import printable

LARGEST_SIDE = 1_000_000


def entry_of(values: object, key: str, where: str, default: object = None) -> object:
    """Return `values[key]`; BadInput if `values` is not an object or lacks the key, unless there is a default."""
    if not isinstance(values, dict):
        raise BadInput(f"{where} is {printable(repr(values))[:40]}, expected an object")
    if key not in values and default is None:
        raise BadInput(f"{where} lacks {key}")
    return values.get(key, default)


def object_of(values: object, key: str, where: str) -> dict:
    """Return `values[key]`, which must be an object."""
    found = entry_of(values, key, where)
    if not isinstance(found, dict):
        raise BadInput(f"{where}: {key} is {printable(repr(found))[:40]}, expected an object")
    return found


def number(values: object, key: str, where: str, default: float | None = None) -> float:
    """Return `values[key]` as a finite number."""
    return float(row([entry_of(values, key, where, default)], 1, f"{where}: {key}")[0])


def size(values: object, where: str, names: tuple[str, str] = ("width", "height")) -> tuple[int, int]:
    """Width and height in whole pixels."""
    sides = [number(values, name, where) for name in names]
    if not all(1 <= side < LARGEST_SIDE and side == round(side) for side in sides):
        raise BadInput(f"{where} has an invalid size of {sides[0]:g}x{sides[1]:g}")
    return round(sides[0]), round(sides[1])


def row(values: object, count: int, where: str) -> np.ndarray:
    """[count] float64."""
    if not isinstance(values, list) or len(values) != count:
        raise BadInput(f"{where} is {printable(repr(values))[:40]}, expected {count} numbers")
    for value in values:
        if not isinstance(value, int | float) or isinstance(value, bool) or not _finite(value):
            raise BadInput(f"{where}: found {printable(repr(value))[:40]}, expected a number")
    return np.array(values, dtype=np.float64)


def _finite(value: float) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:  # an integer too large for a float
        return False
