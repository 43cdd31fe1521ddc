"""Numbers that come from a file: checked here before anything is computed, allocated or indexed by them.

Each function raises InvalidValue saying what was expected and what was found.
"""

import math
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from stylerf.errors import InvalidValue

LARGEST = 1e9  # of lengths in scene units, pixels and factors: float32 can still multiply a few of them
LEARNED = 1e6  # of what is learned: products over the layers of a network stay finite; none trained was over 1e4
_AT_ONCE = 1 << 20  # floats that are looked at together: they stay in the processor's cache


def table(value: Any, what: str) -> dict:
    """`value`, where it is an object of JSON."""
    if not isinstance(value, Mapping):
        raise InvalidValue(f"{what} is {_shown(value)}, expected an object")
    return value


def text(value: Any, what: str) -> str:
    """`value`, where it is a text."""
    if not isinstance(value, str):
        raise InvalidValue(f"{what} holds {_shown(value)}, expected a text")
    return value


def entry(data: Any, key: str, kind: type = object) -> Any:
    """data[key], where `data` is an object of JSON and what it holds there is a `kind`."""
    if key not in table(data, f"what should hold {key}"):
        raise InvalidValue(f"{key} is missing")
    if not isinstance(data[key], kind):
        words = {dict: "an object", list: "a list", str: "a text"}
        raise InvalidValue(f"{key} is {_shown(data[key])}, expected {words[kind]}")
    return data[key]


def one_of(data: Any, key: str, allowed: Collection[str]) -> str:
    """data[key], where it is one of a few words."""
    value = entry(data, key)
    if not isinstance(value, str) or value not in allowed:
        raise InvalidValue(f"{key} is {_shown(value)}, expected one of {', '.join(sorted(allowed))}")
    return value


def integer(data: Any, key: str, low: int, high: int) -> int:
    """data[key], where it is a whole number from low to high; true and false are none."""
    return _integer(entry(data, key), key, low, high)


def integers(data: Any, key: str, count: int, low: int, high: int) -> list[int]:
    """data[key], where it is a list of `count` whole numbers from low to high."""
    return [_integer(value, key, low, high) for value in _list(entry(data, key), key, count)]


def number(data: Any, key: str, low: float = -LARGEST, high: float = LARGEST) -> float:
    """data[key], where it is a finite number from low to high."""
    return _number(entry(data, key), key, low, high)


def numbers(data: Any, key: str, count: int, low: float = -LARGEST, high: float = LARGEST) -> list[float]:
    """data[key], where it is a list of `count` finite numbers from low to high."""
    return [_number(value, key, low, high) for value in _list(entry(data, key), key, count)]


def rows(data: Any, key: str, count: int | None, width: int) -> list[list[float]]:
    """data[key], where it is a list of `count` (None: any number of) lists of `width` finite numbers."""
    found = _list(entry(data, key), key, count)
    return [[_number(value, key, -LARGEST, LARGEST) for value in _list(row, key, width)] for row in found]


def array(
    arrays: Mapping[str, np.ndarray], name: str, dtype: type, shape: tuple[int | None, ...], most: float | None = np.inf
) -> np.ndarray:
    """arrays[name], where it is of that dtype and shape. None: of any length along that axis.

    most: of its floats, which must be finite and lie in -most..most; None: they may be any.
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
    """InvalidValue where an array holds NaN, infinity, or what does not lie in -most..most."""
    flat = values.reshape(-1)
    for at in range(0, len(flat), _AT_ONCE):
        some = flat[at : at + _AT_ONCE]
        fine = np.isfinite(some) if most == np.inf else np.abs(some) <= np.float32(most)  # so written, NaN is not
        if not fine.all():
            where = int(fine.argmin())
            told = "" if most == np.inf else f", expected -{most:g} to {most:g}"
            raise InvalidValue(f"the array {name} holds {some[where]} (number {at + where} of {len(flat)}){told}")


def bits(arrays: Mapping[str, np.ndarray], name: str, cells: int) -> np.ndarray:
    """[cells, cells, cells] bool of the array `name`, eight to a byte, the first the highest (numpy.packbits)."""
    packed = array(arrays, name, np.uint8, (-(-(cells**3) // 8),))
    return np.unpackbits(packed, count=cells**3).astype(bool).reshape((cells,) * 3)


def _integer(value: Any, what: str, low: int, high: int) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise InvalidValue(f"{what} is {_shown(value)}, expected a whole number from {low} to {high}")
    return value


def _number(value: Any, what: str, low: float, high: float) -> float:
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not number or not low <= value <= high:  # so written, NaN is none
        raise InvalidValue(f"{what} is {_shown(value)}, expected a number from {low:g} to {high:g}")
    return float(value)


def _list(value: Any, what: str, count: int | None) -> list:
    if not isinstance(value, list):
        raise InvalidValue(f"{what} holds {_shown(value)}, expected a list")
    if count not in (None, len(value)):
        raise InvalidValue(f"{what} has {len(value)} entries, expected {count}")
    return value


def _shown(value: Any) -> str:
    """What was found, short enough for a line."""
    if value is None or isinstance(value, (bool, dict, list)):
        return {type(None): "null", dict: "an object", list: "a list"}.get(type(value), str(value).lower())
    if isinstance(value, int) and abs(value) >= 10**20:  # str() refuses thousands of digits
        return f"a number of {math.floor(value.bit_length() * math.log10(2)) + 1} digits"
    text = repr(value)
    return text if len(text) <= 40 else text[:37] + "..."
