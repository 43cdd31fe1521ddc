"""Commands that do what the page does: arguments to run, text to copy, a script of a session."""

import shlex
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from stages.configs import flags_of


def command(verb: str, work: Path | str, config: Any = None, **others: str) -> list[str]:
    """Return the arguments of `stylerf`, without the program's name.

    Args:
        config: options of the verb; those that differ from their defaults are written.
        others: arguments that are no options of a stage, such as of, region and name; empty ones are left out.
    """
    arguments = [verb, str(work), *(flags_of(config) if config is not None else [])]
    for name, value in others.items():
        if value:
            arguments += [f"--{name}", value]
    return arguments


def as_text(arguments: Iterable[str]) -> str:
    """Return a command as a shell takes it."""
    return shlex.join(["stylerf", *arguments])


def script_of(commands: Iterable[list[str]]) -> str:
    """Return a shell script that runs the commands and ends at the first that fails."""
    return "\n".join(["#!/bin/sh", "set -e", *map(as_text, commands), ""])
