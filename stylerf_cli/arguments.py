"""Flags from config dataclasses, and configs from flags and TOML. Flags override TOML, which overrides defaults."""

import argparse
import dataclasses
import difflib
import math
import tomllib
import typing
from collections.abc import Collection
from pathlib import Path
from typing import Any, NoReturn, TypeAlias

from schemas.errors import UsageError
from schemas.safe_reading import read_text
from stages.configs import default_of, flag_of, options_of
from stages.configs.typed import shape_of, typed
from stages.run.memory import bytes_of

DEVICES = ("auto", "cpu", "cuda")
LARGEST_CONFIG, MOST_DOTS = 64 << 10, 1000  # bytes; in one line
Field: TypeAlias = "dataclasses.Field[Any]"


class Parser(argparse.ArgumentParser):
    """An argument parser that raises UsageError and does not accept abbreviations."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(allow_abbrev=False, **settings)

    def positionals(self) -> str:
        """Return the positional arguments as a usage line shows them."""
        forms: dict[int | str | None, str] = {None: "{}", "?": "[{}]", "+": "{} ...", "*": "[{} ...]"}
        return " ".join(forms[one.nargs].format(one.metavar or one.dest) for one in self._get_positional_actions())

    def error(self, message: str) -> NoReturn:
        """Raise what argparse would print together with the usage."""
        hint = ""
        if message.startswith("unrecognized arguments: -"):
            hint = nearest(message.split()[2].partition("=")[0], list(self._option_string_actions), listing=False)
        raise UsageError(f"{message}{hint}; see `{self.prog} --help`")


def add_common(parser: Parser, everything: bool = True) -> None:
    """Add the options that every verb has. everything: show the advanced ones in the help too."""
    group = parser.add_argument_group("common options")

    def advanced(text: str) -> str:
        return text if everything else argparse.SUPPRESS

    group.add_argument("--json", action="store_true", help="print the result as one JSON object")
    group.add_argument("--quiet", action="store_true", help="print only errors, no progress or notes")
    group.add_argument(
        "--config", type=Path, metavar="FILE.toml", help="read options from a file; command-line flags take precedence"
    )
    group.add_argument("--name", help="name of the artifact (default: set by the verb)")
    group.add_argument("--force", action="store_true", help="rebuild what is up to date")
    group.add_argument("--seed", type=_whole, help="random seed (default: 0)")
    group.add_argument("--device", choices=DEVICES, help="where to compute (default: auto)")
    group.add_argument("--threads", type=_positive, metavar="N", help=advanced("CPU threads (default: all available)"))
    group.add_argument(
        "--memory",
        type=_memory,
        metavar="SIZE",
        help=advanced("memory limit, such as 512M or 8G (default: most of the free memory)"),
    )
    group.add_argument(
        "--only", action="store_true", help=advanced("stop if an earlier stage is missing or out of date")
    )
    group.add_argument(
        "--no-paths", action="store_true", help=advanced("record external files by name only, without their folders")
    )


def add_config(parser: Parser, config: type, everything: bool = True) -> None:
    """Add a flag for each option of a config dataclass; only those given appear in the namespace.

    Args:
        everything: show advanced options in the help too, under their groups.
    """
    groups: dict[str, argparse._ActionsContainer] = {"": parser}
    for item, kind in _fields(config):
        heading = item.metadata["group"] if everything else ""
        if heading not in groups:
            groups[heading] = parser.add_argument_group(heading)
        _add_field(groups[heading], item, kind, everything or not item.metadata["advanced"])


def _fields(config: type) -> list[tuple[Field, Any]]:
    kinds = typing.get_type_hints(config)
    return [(item, kinds[item.name]) for item in options_of(config)]


def _add_field(group: argparse._ActionsContainer, item: Field, kind: Any, shown: bool) -> None:
    meta = item.metadata
    settings: dict[str, Any] = {"help": _help(item) if shown else argparse.SUPPRESS, "default": argparse.SUPPRESS}
    base, many = shape_of(kind)
    if base is bool:
        settings["action"] = argparse.BooleanOptionalAction
    else:
        settings["type"] = {int: _whole, float: _number}.get(base, base)
        if many is not None:
            settings["nargs"] = many or "+"
            if many == 0:
                settings["action"] = "extend"  # `--layers a b --layers c` is three layers
        choices = tuple(meta["choices"] or ())
        if choices:
            settings["choices"] = choices
        settings["metavar"] = meta["metavar"] or "|".join(map(str, choices)) or item.name.rpartition("_")[2].upper()
    group.add_argument(flag_of(item), dest=item.name, required=False, **settings)


def _required(item: Field) -> bool:
    return default_of(item) is dataclasses.MISSING


def _help(item: Field) -> str:
    text = str(item.metadata["help"]).replace("%", "%%")
    if _required(item) or "default:" in text:
        return text
    default = default_of(item)
    shown = " ".join(map(str, default)) if isinstance(default, tuple) else str(default).replace("%", "%%")
    return f"{text} (default: {shown})" if default not in ("", None, ()) else text


def _whole(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected a whole number, not {text!r}") from None


def _positive(text: str) -> int:
    value = _whole(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"expected a number of at least 1, not {text!r}")
    return value


def _memory(text: str) -> str:
    try:
        bytes_of(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    return text


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"expected a number, not {text!r}")
    return value


def build_config(
    config: type, flags: argparse.Namespace, table: dict[str, Any], where: str, others: Collection[type] = ()
) -> Any:
    """Build the config of a verb from flags and a TOML table.

    Args:
        flags: flags, which override the table.
        table: options from the file.
        where: names the table in errors.
        others: configs of the verb's other uses, whose keys are ignored.

    Raises:
        UsageError: an unknown key (the nearest known one is suggested), a value of the wrong type, a missing required
            option, or anything the config itself rejects.
    """
    elsewhere = {item.name for other in others for item in options_of(other)}
    kinds = dict((item.name, (item, kind)) for item, kind in _fields(config))
    values: dict[str, Any] = {}
    for key, value in table.items():
        name = key.replace("-", "_")
        if name in kinds and not hasattr(flags, name):
            values[name] = typed(value, *kinds[name], f"{where}: {key}")
        elif name not in kinds and name not in elsewhere:
            raise UsageError(f"{where}: unknown option {key!r}{nearest(name, list(kinds))}")
    of_file = set(values)
    for name, (item, _) in kinds.items():
        if hasattr(flags, name):
            value = getattr(flags, name)
            values[name] = tuple(value) if isinstance(value, list) else value
        elif name not in values and _required(item):
            raise UsageError(f"{flag_of(item)} is required")
    try:
        return config(**values)
    except ValueError as error:
        # The config's own message does not name the source of a value.
        source = f" (options from {where}: {', '.join(sorted(of_file))})" if of_file else ""
        raise UsageError(f"{error}{source}") from error


def nearest(word: str, known: list[str], listing: bool = True) -> str:
    """Suggest the known word most like `word`, else (if `listing`) list the known ones."""
    close = difflib.get_close_matches(word, known, n=1, cutoff=0.5)
    if close:
        return f"; did you mean {close[0]!r}?"
    return f"; choose from {', '.join(known)}" if known and listing else ""


def read_toml(path: Path) -> dict[str, Any]:
    """Return the tables of a TOML file; UsageError if it is missing or invalid."""
    try:
        text = read_text(path, LARGEST_CONFIG, UsageError)
        if any(line.count(".") > MOST_DOTS for line in text.splitlines()):  # tomllib takes quadratic time
            raise UsageError(f"--config {path} is nested too deeply to be read")
        return _checked_integers(tomllib.loads(text), path)
    except FileNotFoundError:
        raise UsageError(f"--config {path}: file not found") from None
    except RecursionError:
        raise UsageError(f"--config {path} is nested too deeply to be read") from None
    except ValueError as error:  # invalid TOML, or numbers with thousands of digits
        raise UsageError(f"--config {path} is not valid TOML: {error}") from error


def _checked_integers(content: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return `content`; UsageError if an integer needs more than TOML's 64 bits."""
    left: list[Any] = [content]
    while left:
        value = left.pop()
        if isinstance(value, dict):
            left.extend(value.values())
        elif isinstance(value, list):
            left.extend(value)
        elif isinstance(value, int) and not -(1 << 63) <= value < 1 << 63:
            raise UsageError(f"--config {path}: an integer of {value.bit_length()} bits is more than TOML's 64")
    return content
