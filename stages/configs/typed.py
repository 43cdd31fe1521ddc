"""Options from files of data, such as TOML and manifests: values of the types that the configs declare."""

import math
import typing
from dataclasses import Field
from pathlib import Path
from typing import Any

from schemas.errors import UsageError


def shape_of(kind: Any) -> tuple[Any, int | None]:
    """Return the type of one value, and the number of values: None for one, 0 for one or more, n for exactly n."""
    if typing.get_origin(kind) is tuple:
        inner = typing.get_args(kind)
        return inner[0], 0 if inner[-1] is Ellipsis else len(inner)
    return kind, None


def typed(value: Any, item: "Field[Any]", kind: Any, where: str) -> Any:
    """Return a value from a file as an option of a config has it: a list as a tuple, a whole number as a float.

    Args:
        item, kind: the option and its type.
        where: names the value in errors.

    Raises:
        UsageError: it is of another type, or none of the option's choices.
    """
    base, many = shape_of(kind)
    if many is not None:
        if not isinstance(value, list) or (many and len(value) != many) or not value:
            raise UsageError(f"{where} takes a list of {many or 'one or more'} values, not {value!r}")
        return tuple(_one(one, base, item, where) for one in value)
    return _one(value, base, item, where)


def _one(value: Any, base: Any, item: "Field[Any]", where: str) -> Any:
    choices = item.metadata.get("choices")
    if choices and value not in choices:
        raise UsageError(f"{where} is {value!r}; expected one of {', '.join(map(str, choices))}")
    if base is Path and isinstance(value, str):
        return Path(value)
    sound = isinstance(value, base) or (base is float and isinstance(value, int))
    sound = sound and (base is bool or not isinstance(value, bool))
    if not sound or (isinstance(value, float) and not math.isfinite(value)):
        words = {int: "a whole number", float: "a number", str: "a text in quotes", bool: "true or false"}
        raise UsageError(f"{where} takes {words.get(base, base.__name__)}, not {value!r}")
    return float(value) if base is float else value
