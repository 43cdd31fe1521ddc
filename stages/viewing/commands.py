"""Commands that do what the page does: arguments to run, text to copy, a script of a session."""

import re
import shlex
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from schemas.safe_names import printable
from stages.configs import flags_of

COMMAND_WIDTH = 46  # characters that a panel has room for


def command(verb: str, work: Path | str, config: Any = None, **others: str) -> list[str]:
    """Return the arguments of `stylerf`, without the program's name.

    Args:
        config: options of the verb; those that differ from their defaults are written.
        others: arguments that are not options of a stage, such as of, region and name; empty ones are left out.
    """
    arguments = [verb, str(work), *(flags_of(config) if config is not None else [])]
    for name, value in others.items():
        if value:
            arguments += [f"--{name}", value]
    return arguments


def as_text(arguments: Iterable[str]) -> str:
    """Return a command as a shell takes it."""
    return shlex.join(["stylerf", *arguments])


def wrapped(arguments: Iterable[str], width: int) -> str:
    """Return a command to be shown, in lines of about `width` characters that go on after a backslash.

    Control characters, which the names and options of a stranger's work folder may hold, are escaped.
    """
    pieces = ["stylerf"]  # of words that stay together: an option and its value
    for word in map(shlex.quote, map(printable, arguments)):
        if word.startswith("--"):
            pieces.append(word)
        else:
            pieces[-1] += f" {word}"
    lines = pieces[:1]
    for piece in pieces[1:]:
        if len(lines[-1]) + 1 + len(piece) <= width:
            lines[-1] += f" {piece}"
        else:
            lines.append(f"  {piece}")
    return " \\\n".join(lines)


def script_of(commands: Iterable[list[str]]) -> str:
    """Return a shell script that runs the commands and ends at the first that fails."""
    return "\n".join(["#!/bin/sh", "set -e", *map(as_text, commands), ""])


def fenced(language: str, text: str) -> str:
    """Return text as a block of code in Markdown, which it cannot end: viser renders the HTML in Markdown."""
    text = "\n".join(map(printable, text.split("\n")))
    text = text.replace("](", "] (")  # even in code, viser reads the file that a picture's address names
    fence = "`" * max(3, 1 + max(map(len, re.findall("`+", text)), default=0))
    return f"{fence}{language}\n{text}\n{fence}"
