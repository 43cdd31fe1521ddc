"""From config dataclasses to flags, and from flags and a TOML file to a config: flags win over TOML over defaults."""

import argparse
import dataclasses
import difflib
import math
import tomllib
import typing
from collections.abc import Collection
from pathlib import Path
from typing import Any, NoReturn

from schemas.errors import UsageError
from schemas.flag_text import flags
from schemas.safe_reading import read_text
from stages.run.memory import bytes_of

LARGEST_CONFIG, MOST_DOTS = 64 << 10, 1000  # bytes; of a line


class Parser(argparse.ArgumentParser):
    """An argument parser whose faults are UsageErrors, and which takes no abbreviations."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(allow_abbrev=False, **settings)

    def error(self, message: str) -> NoReturn:
        """Raises what argparse would print with a page of usage."""
        hint = ""
        if message.startswith("unrecognized arguments: -"):
            hint = nearest(message.split()[2].partition("=")[0], list(self._option_string_actions), listing=False)
        raise UsageError(f"{message}{hint}; see `{self.prog} --help`")


def add_common(parser: Parser) -> None:
    """The flags that every verb has."""
    common = parser.add_argument_group("common options")
    common.add_argument("--json", action="store_true", help="print the result as one JSON object on stdout")
    common.add_argument("--quiet", action="store_true", help="no progress and no notes on stderr, only faults")
    common.add_argument("--seed", type=_whole, help="seed of everything random (default: 0)")
    common.add_argument("--device", choices=("auto", "cpu", "cuda"), help="where to compute (default: auto)")
    common.add_argument("--threads", type=_positive, metavar="N", help="CPU threads (default: all it may use)")
    common.add_argument(
        "--memory", type=_memory, metavar="SIZE", help="most memory to take, 512M or 8G (default: most of what is free)"
    )
    common.add_argument("--name", help="name of the artifact to write (default: told by the verb)")
    common.add_argument("--config", type=Path, metavar="FILE.toml", help="options from a file; flags win over it")
    common.add_argument("--only", action="store_true", help="do not bring earlier stages up to date; stop instead")
    common.add_argument(
        "--no-paths", action="store_true", help="write names of files from outside, not the folders they lie in"
    )
    common.add_argument("--force", action="store_true", help="make it anew even if it stands up to date")


def add_config(parser: Parser, config: type) -> None:
    """One flag for each field of a config dataclass; only those given appear in the namespace."""
    group = parser.add_argument_group("options of this verb")
    for item, kind in _fields(config):
        _add_field(group, item, kind)


def _fields(config: type) -> list[tuple[dataclasses.Field, Any]]:
    kinds = typing.get_type_hints(config)
    return [(item, kinds[item.name]) for item in dataclasses.fields(config)]


def _add_field(group: Any, item: dataclasses.Field, kind: Any) -> None:
    meta = item.metadata
    settings: dict[str, Any] = {"help": _help(item), "default": argparse.SUPPRESS}
    base, many = _shape(kind)
    if base is bool:
        settings["action"] = argparse.BooleanOptionalAction
    else:
        settings["type"] = {int: _whole, float: _number}.get(base, base)
        if many is not None:
            settings["nargs"] = many or "+"
            if many == 0:
                settings["action"] = "extend"  # `--layers a b --layers c` is three layers
        choices = tuple(meta.get("choices") or ())
        if choices:
            settings["choices"] = choices
        words = "|".join(map(str, choices)) or item.name.rpartition("_")[2].upper()
        settings["metavar"] = meta.get("metavar") or words
    group.add_argument(_flag(item), dest=item.name, required=False, **settings)


def _flag(item: dataclasses.Field) -> str:
    return item.metadata.get("flag") or "--" + item.name.replace("_", "-")


def _required(item: dataclasses.Field) -> bool:
    return item.default is dataclasses.MISSING and item.default_factory is dataclasses.MISSING


def _help(item: dataclasses.Field) -> str:
    text = item.metadata.get("help", "").replace("%", "%%")
    if _required(item) or "default:" in text:
        return text
    default = _default(item)
    shown = " ".join(map(str, default)) if isinstance(default, tuple) else str(default).replace("%", "%%")
    return f"{text} (default: {shown})" if default not in ("", None, ()) else text


def _default(item: dataclasses.Field) -> Any:
    return item.default if item.default_factory is dataclasses.MISSING else item.default_factory()


def flags_of(config: Any) -> list[str]:
    """The flags that make a config of its defaults; digests are left out, which the verb fills in."""
    given: list[str] = []
    for item in dataclasses.fields(config):
        value = getattr(config, item.name)
        if value == _default(item) or item.name.endswith("_digest"):
            continue
        given += flags(_flag(item), value)
    return given


def _shape(kind: Any) -> tuple[Any, int | None]:
    """Type of one value, and how many: None one, 0 one or more, n exactly n."""
    if typing.get_origin(kind) is tuple:
        inner = typing.get_args(kind)
        return inner[0], 0 if inner[-1] is Ellipsis else len(inner)
    return kind, None


def _whole(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"a whole number was expected, not {text!r}") from None


def _positive(text: str) -> int:
    value = _whole(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"a number of at least 1 was expected, not {text!r}")
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
    if math.isnan(value):
        raise argparse.ArgumentTypeError(f"a number was expected, not {text!r}")
    return value


def build_config(
    config: type, given: argparse.Namespace, table: dict[str, Any], where: str, others: Collection[type] = ()
) -> Any:
    """The config of a verb from its flags and a TOML table (`where` names it in faults).

    A key that has its flag counts for nothing. Keys of `others`, the configs of the verb's other uses, are passed over.
    UsageError for unknown keys (naming the nearest known one), values of a wrong type, missing required ones, and
    whatever the config itself refuses.
    """
    elsewhere = {item.name for other in others for item in dataclasses.fields(other)}
    kinds = dict((item.name, (item, kind)) for item, kind in _fields(config))
    values: dict[str, Any] = {}
    for key, value in table.items():
        name = key.replace("-", "_")
        if name in kinds and not hasattr(given, name):
            values[name] = _from_toml(value, *kinds[name], f"{where}: {key}")
        elif name not in kinds and name not in elsewhere:
            raise UsageError(f"{where}: there is no option {key!r}{nearest(name, list(kinds))}")
    of_file = set(values)
    for name, (item, _) in kinds.items():
        if hasattr(given, name):
            value = getattr(given, name)
            values[name] = tuple(value) if isinstance(value, list) else value
        elif name not in values and _required(item):
            raise UsageError(f"{_flag(item)} is required")
    try:
        return config(**values)
    except ValueError as error:
        # A config refuses in its own words, which do not know where a value came from.
        source = f" (options from {where}: {', '.join(sorted(of_file))})" if of_file else ""
        raise UsageError(f"{error}{source}") from error


def _from_toml(value: Any, item: dataclasses.Field, kind: Any, where: str) -> Any:
    base, many = _shape(kind)
    if many is not None:
        if not isinstance(value, list) or (many and len(value) != many) or not value:
            raise UsageError(f"{where} takes a list of {many or 'one or more'} values, not {value!r}")
        return tuple(_one_from_toml(one, base, item, where) for one in value)
    return _one_from_toml(value, base, item, where)


def _one_from_toml(value: Any, base: Any, item: dataclasses.Field, where: str) -> Any:
    choices = item.metadata.get("choices")
    if choices and value not in choices:
        raise UsageError(f"{where} is {value!r}; expected one of {', '.join(map(str, choices))}")
    if base is Path and isinstance(value, str):
        return Path(value)
    sound = isinstance(value, base) or (base is float and isinstance(value, int))
    if not sound or (isinstance(value, bool) and base is not bool) or (isinstance(value, float) and math.isnan(value)):
        words = {int: "a whole number", float: "a number", str: "a text in quotes", bool: "true or false"}
        raise UsageError(f"{where} takes {words.get(base, base.__name__)}, not {value!r}")
    return float(value) if base is float else value


def nearest(word: str, known: list[str], listing: bool = True) -> str:
    """`; did you mean 'x'?` for the known word most like `word`, else (if `listing`) a list of the known ones."""
    close = difflib.get_close_matches(word, known, n=1, cutoff=0.5)
    if close:
        return f"; did you mean {close[0]!r}?"
    return f"; known are {', '.join(known)}" if known and listing else ""


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file; UsageError where it is missing or no TOML."""
    try:
        text = read_text(path, LARGEST_CONFIG, UsageError)
        if any(line.count(".") > MOST_DOTS for line in text.splitlines()):  # tomllib's time grows by their square
            raise UsageError(f"--config {path} is nested too deeply to be read")
        return tomllib.loads(text)
    except FileNotFoundError:
        raise UsageError(f"--config {path} cannot be read: there is no such file") from None
    except RecursionError:
        raise UsageError(f"--config {path} is nested too deeply to be read") from None
    except ValueError as error:  # of TOML, and of numbers with thousands of digits
        raise UsageError(f"--config {path} is no TOML: {error}") from error
