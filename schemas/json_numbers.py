"""Checks of numbers from JSON documents before they are used in allocations or computations; ValueError on failure.

stylerf/validation.py does the same for descriptions of fields, regions and edits; neither may import the other.
"""

from typing import Any

LARGEST = 1e9  # scene units and pixels: products of a few of these still fit float32
LARGEST_SIDE = 32768  # pixels
LARGEST_PICTURE = 1 << 28  # width times height, pixels
FOCAL_LENGTHS = (1e-3, LARGEST)  # pixels


def whole(value: Any, what: str, low: int, high: int) -> int:
    """Return `value` if it is an integer, and not a bool, from low to high."""
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise ValueError(f"{what} is {_shown(value)}, expected a whole number from {low} to {high}")
    return value


def number(value: Any, what: str, low: float = -LARGEST, high: float = LARGEST) -> float:
    """Return `value` as a float if it is a finite number from low to high."""
    known = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not known or not low <= value <= high:  # NaN fails this comparison
        raise ValueError(f"{what} is {_shown(value)}, expected a number from {low:g} to {high:g}")
    return float(value)


def numbers(values: Any, what: str, count: int, low: float = -LARGEST, high: float = LARGEST) -> tuple[float, ...]:
    """Return `values` if they are a list of `count` finite numbers from low to high."""
    if not isinstance(values, (list, tuple)) or len(values) != count:
        raise ValueError(f"{what} is {_shown(values)}, expected {count} numbers")
    return tuple(number(value, what, low, high) for value in values)


def matrix(values: Any, what: str, largest: float = LARGEST) -> tuple[tuple[float, ...], ...]:
    """Return `values` if they are four lists of four finite numbers."""
    if not isinstance(values, (list, tuple)) or len(values) != 4:
        raise ValueError(f"{what} is {_shown(values)}, expected 4 rows of 4 numbers")
    return tuple(numbers(row, what, 4, -largest, largest) for row in values)


def _shown(value: Any) -> str:
    """Describe `value` briefly."""
    if value is None or isinstance(value, (bool, dict, list, tuple)):
        return {type(None): "null", bool: str(value).lower(), dict: "an object"}.get(type(value), "a list")
    if isinstance(value, int) and abs(value) >= 10**20:  # str() rejects thousands of digits
        return f"an integer of {value.bit_length()} bits"
    text = repr(value)
    return text if len(text) <= 40 else text[:37] + "..."
