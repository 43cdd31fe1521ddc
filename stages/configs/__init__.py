"""One frozen dataclass per stage: its options and their defaults, free of heavy imports so that `--help` is instant."""

from dataclasses import MISSING, field
from typing import Any


def option(
    default: Any = MISSING,
    *,
    help: str,
    choices: tuple | None = None,
    metavar: str | None = None,
    flag: str | None = None,
    positional: bool = False,
) -> Any:
    """A dataclass field that also is a command-line flag, `--field-name` unless `flag` says another.

    help, choices and metavar are what the command line shows; a `positional` one is given without a flag.
    """
    metadata = {"help": help, "choices": choices, "metavar": metavar, "flag": flag, "positional": positional}
    return field(default=default, metadata=metadata)
