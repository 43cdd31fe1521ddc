"""One frozen dataclass per stage: its options and their defaults, free of heavy imports so that `--help` is instant."""

from dataclasses import MISSING, field
from typing import Any


def option(default: Any = MISSING, *, help: str, choices: tuple | None = None, metavar: str | None = None) -> Any:
    """A dataclass field that also is a command-line flag: `--field-name`, with its help text and choices."""
    metadata = {"help": help, "choices": choices, "metavar": metavar}
    return field(default=default, metadata=metadata)
