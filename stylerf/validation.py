"""Validate numbers read from files before they are used in computations, allocations or as indices.

Every function raises InvalidValue, whose message says what was expected and what was found.
"""

import math
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from stylerf.errors import InvalidValue

LARGEST = 1e9  # scene units, pixels, factors: products of a few of these still fit in float32
LEARNED = 1e6  # trained values: products over a network's layers stay finite; none observed above 1e4
_AT_ONCE = 1 << 20  # floats to check at once, so that they stay in the CPU cache


def table(value: Any, what: str) -> dict[str, Any]:
    """Return `value` if it is a JSON object."""
    if not isinstance(value, dict):
        raise InvalidValue(f"{what} is {_shown(value)}, expected an object")
    return value


def text(value: Any, what: str) -> str:
    """Return `value` if it is a string."""
    if not isinstance(value, str):
        raise InvalidValue(f"{what} holds {_shown(value)}, expected a string")
    return value


def entry(data: Any, key: str, kind: type = object) -> Any:
    """Return data[key] if `data` is a JSON object and that value is a `kind`."""
    if key not in table(data, f"what should hold {key}"):
        raise InvalidValue(f"{key} is missing")
    if not isinstance(data[key], kind):
        words: dict[type, str] = {dict: "an object", list: "a list", str: "a string"}
        raise InvalidValue(f"{key} is {_shown(data[key])}, expected {words[kind]}")
    return data[key]


def one_of(data: Any, key: str, allowed: Collection[str]) -> str:
    """Return data[key] if it is one of the `allowed` strings."""
    value = entry(data, key)
    if not isinstance(value, str) or value not in allowed:
        raise InvalidValue(f"{key} is {_shown(value)}, expected one of {', '.join(sorted(allowed))}")
    return value


def integer(data: Any, key: str, low: int, high: int) -> int:
    """Return data[key] if it is an integer (not a bool) from low to high."""
    return _integer(entry(data, key), key, low, high)


def integers(data: Any, key: str, count: int, low: int, high: int) -> list[int]:
    """Return data[key] if it is a list of `count` integers from low to high."""
    return [_integer(value, key, low, high) for value in _list(entry(data, key), key, count)]


def number(data: Any, key: str, low: float = -LARGEST, high: float = LARGEST) -> float:
    """Return data[key] if it is a finite number from low to high."""
    return _number(entry(data, key), key, low, high)


def numbers(data: Any, key: str, count: int, low: float = -LARGEST, high: float = LARGEST) -> list[float]:
    """Return data[key] if it is a list of `count` finite numbers from low to high."""
    return [_number(value, key, low, high) for value in _list(entry(data, key), key, count)]


def rows(data: Any, key: str, count: int | None, width: int) -> list[list[float]]:
    """Return data[key] if it is a list of `count` (None: any number of) lists of `width` finite numbers."""
    found = _list(entry(data, key), key, count)
    return [[_number(value, key, -LARGEST, LARGEST) for value in _list(row, key, width)] for row in found]


def array(
    arrays: Mapping[str, np.ndarray], name: str, dtype: type, shape: tuple[int | None, ...], most: float | None = np.inf
) -> np.ndarray:
    """Return arrays[name] if it has this dtype and shape, and its floats are finite.

    Args:
        arrays: Arrays by name.
        name: The array to check.
        dtype: Expected type.
        shape: Expected shape; None for any length along an axis.
        most: Maximum magnitude of floats; None to also accept NaN and infinity.
    """
    if name not in arrays:
        raise InvalidValue(f"the array {name} is missing")
    found = arrays[name]
    fits = len(found.shape) == len(shape) and all(b in (None, a) for a, b in zip(found.shape, shape))
    if found.dtype != dtype or not fits:
        wanted = " x ".join("any" if side is None else str(side) for side in shape)
        held = " x ".join(map(str, found.shape))
        raise InvalidValue(f"the array {name} holds {held} {found.dtype}, expected {wanted} {np.dtype(dtype)}")
    if found.dtype.kind == "f" and most is not None:
        finite(found, name, most)
    return found


def finite(values: np.ndarray, name: str, most: float = np.inf) -> None:
    """Raise InvalidValue if an array holds NaN, infinity or a magnitude above `most`."""
    flat = values.reshape(-1)
    for at in range(0, len(flat), _AT_ONCE):
        some = flat[at : at + _AT_ONCE]
        fine = np.isfinite(some) if most == np.inf else np.abs(some) <= np.float32(most)  # NaN fails this comparison
        if not fine.all():
            where = int(fine.argmin())
            wanted = "" if most == np.inf else f", expected -{most:g} to {most:g}"
            raise InvalidValue(f"the array {name} holds {some[where]} (number {at + where} of {len(flat)}){wanted}")


def bits(arrays: Mapping[str, np.ndarray], name: str, cells: int) -> np.ndarray:
    """Unpack the array `name`, packed by numpy.packbits, to [cells, cells, cells] bool."""
    packed = array(arrays, name, np.uint8, (-(-(cells**3) // 8),))
    return np.unpackbits(packed, count=cells**3).astype(bool).reshape((cells,) * 3)


def _integer(value: Any, what: str, low: int, high: int) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise InvalidValue(f"{what} is {_shown(value)}, expected a whole number from {low} to {high}")
    return value


def _number(value: Any, what: str, low: float, high: float) -> float:
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not number or not low <= value <= high:  # NaN fails this comparison
        raise InvalidValue(f"{what} is {_shown(value)}, expected a number from {low:g} to {high:g}")
    return float(value)


def _list(value: Any, what: str, count: int | None) -> list[Any]:
    if not isinstance(value, list):
        raise InvalidValue(f"{what} holds {_shown(value)}, expected a list")
    if count not in (None, len(value)):
        raise InvalidValue(f"{what} has {len(value)} entries, expected {count}")
    return value


def _shown(value: Any) -> str:
    """Return a brief description of `value`."""
    if value is None or isinstance(value, (bool, dict, list)):
        return {type(None): "null", dict: "an object", list: "a list"}.get(type(value), str(value).lower())
    if isinstance(value, int) and abs(value) >= 10**20:  # str() refuses thousands of digits
        return f"a number of {math.floor(value.bit_length() * math.log10(2)) + 1} digits"
    text = repr(value)
    return text if len(text) <= 40 else text[:37] + "..."
