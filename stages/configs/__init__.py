"""One frozen dataclass per stage: its options and their defaults, free of heavy imports so that `--help` is instant."""

from dataclasses import MISSING, field, fields
from typing import Any


def option(
    default: Any = MISSING,
    *,
    help: str,
    choices: tuple | None = None,
    metavar: str | None = None,
    flag: str | None = None,
    incidental: bool = False,
    digest: str = "",
) -> Any:
    """A dataclass field that also is a command-line flag, `--field-name` unless `flag` says another.

    help, choices and metavar are what the command line shows. An `incidental` one has no say in the result: what was
    made with another value of it need not be made anew. digest: the field that tells what lies at a path; where it is
    filled in, the path is incidental.
    """
    metadata = {"help": help, "choices": choices, "metavar": metavar, "flag": flag, "incidental": incidental}
    return field(default=default, metadata=metadata | {"digest": digest})


def incidental(config: Any) -> set[str]:
    """Names of the options of a config that have no say in the result."""
    told = {item.name: item.metadata.get("digest") for item in fields(config)}
    return {item.name for item in fields(config) if item.metadata.get("incidental")} | {
        name for name, digest in told.items() if digest and getattr(config, digest, "")
    }
