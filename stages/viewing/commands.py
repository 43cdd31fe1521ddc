"""Commands equivalent to the page's actions: arguments to run, text to copy, a script of a session."""

import re
import shlex
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from schemas.safe_names import printable
from stages.configs import flags_of

COMMAND_WIDTH = 46  # characters that fit in a panel


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
    """Return a command as shell text."""
    return shlex.join(["stylerf", *arguments])


def wrapped(arguments: Iterable[str], width: int) -> str:
    """Return a command for display, in lines of about `width` characters continued by a backslash.

    Control characters, which names and options of an untrusted work folder may contain, are escaped.
    """
    pieces = ["stylerf"]  # words that stay together: an option and its value
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
    """Return a shell script that runs the commands and stops at the first that fails."""
    return "\n".join(["#!/bin/sh", "set -e", *map(as_text, commands), ""])


def fenced(language: str, text: str) -> str:
    """Return text as a Markdown code block that it cannot close: viser renders the HTML in Markdown."""
    text = "\n".join(map(printable, text.split("\n")))
    text = text.replace("](", "] (")  # even in code, viser reads the file named by a picture's address
    fence = "`" * max(3, 1 + max(map(len, re.findall("`+", text)), default=0))
    return f"{fence}{language}\n{text}\n{fence}"
