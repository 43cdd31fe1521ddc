"""One frozen dataclass per stage: its options and their defaults. No heavy imports, so that `--help` is instant."""

from dataclasses import MISSING, Field, field, fields
from typing import Any, TypeVar

from schemas.safe_names import flags

Config = TypeVar("Config")


def option(
    default: Any = MISSING,
    *,
    help: str,
    choices: tuple[Any, ...] | None = None,
    metavar: str | None = None,
    flag: str | None = None,
    incidental: bool = False,
    extent: bool = False,
    digest: str = "",
    advanced: bool = False,
    group: str = "",
) -> Any:
    """Declare a dataclass field that is also a command-line option.

    A field declared without `option` is part of the recipe but has neither a flag nor a `--config` key: digests, which
    the pipeline fills in.

    Args:
        default: value if the option is not given; without one the option is required.
        help: one line: what the option does. The default is appended unless the text names it.
        choices: the values it takes.
        metavar: placeholder for the value in `--help`.
        flag: the flag, if other than `--field-name`.
        incidental: the option does not affect the result, so changing it does not make an artifact stale.
        extent: the option says how far a run goes, so a run that was interrupted under another value resumes.
        digest: the field that holds the digest of the file this option names. Once filled in, the path is incidental.
        advanced: list the option only in `--help-all`.
        group: heading that `--help-all` lists it under.
    """
    metadata = {"help": help, "choices": choices, "metavar": metavar, "flag": flag, "incidental": incidental}
    metadata |= {"extent": extent, "digest": digest, "advanced": advanced, "group": group}
    return field(default=default, metadata=metadata)


def advanced(default: Any, group: str = "", **others: Any) -> Any:
    """Declare an option, as `option` does, that only `--help-all` lists, under the heading `group`."""
    return option(default, advanced=True, group=group, **others)


def options_of(config: Any) -> "list[Field[Any]]":
    """Return the fields of a config class or object that are options."""
    return [item for item in fields(config) if "help" in item.metadata]


def incidental(config: Any) -> set[str]:
    """Return the names of the options of a config that do not affect the result."""
    return {
        item.name
        for item in fields(config)
        if item.metadata.get("incidental") or getattr(config, item.metadata.get("digest") or "", "")
    }


def extent(config: Any) -> set[str]:
    """Return the names of the options of a config that say how far a run goes."""
    return {item.name for item in fields(config) if item.metadata.get("extent")}


def flag_of(item: "Field[Any]") -> str:
    """Return the command-line flag of an option."""
    return item.metadata["flag"] or "--" + item.name.replace("_", "-")


def default_of(item: "Field[Any]") -> Any:
    """Return the default of an option, MISSING if it is required."""
    return item.default if item.default_factory is MISSING else item.default_factory()


def part_of(config: Any, kind: type[Config]) -> Config:
    """Return the fields of a config that inherits from the dataclass `kind` as a `kind`."""
    return kind(**{item.name: getattr(config, item.name) for item in fields(kind)})  # type: ignore[arg-type]


def flags_of(config: Any) -> list[str]:
    """Return the command-line arguments that set the options of `config` which differ from their defaults."""
    arguments: list[str] = []
    for item in options_of(config):
        value = getattr(config, item.name)
        if value != default_of(item):
            arguments += flags(flag_of(item), value)
    return arguments
