"""Options of `stylerf blend`."""

import math
import re
from collections import Counter
from dataclasses import dataclass

from stages.configs import option

ROUNDING = 1e-6  # of a sum of weights


@dataclass(frozen=True)
class Part:
    """A field to blend. region: where, empty for everywhere. weight: 0..1; None: what the others leave."""

    field: str
    region: str = ""
    weight: float | None = None


@dataclass(frozen=True)
class BlendConfig:
    """Which fields are blended, how much of each, and where."""

    of: tuple[str, ...] = option(
        metavar="FIELD[:REGION][=WEIGHT]",
        help="stylizations of the same field, with weights of 0 to 1 (without: equal shares of the rest); "
        "FIELD:REGION replaces them in that region (default weight: 1)",
    )

    def __post_init__(self) -> None:
        _weighed([part_of(text) for text in self.of])

    @property
    def parts(self) -> tuple[Part, ...]:
        """The fields, each with a weight."""
        return _weighed([part_of(text) for text in self.of])


def part_of(text: str) -> Part:
    """Parse 'wave:shovel=0.8' as Part('wave', 'shovel', 0.8); ValueError for anything else."""
    match = re.fullmatch(r"([^:=]+)(?::([^:=]+))?(?:=([^:=]+))?", text)
    if not match:
        raise ValueError(f"--of {text!r} is not written FIELD, FIELD=WEIGHT, FIELD:REGION or FIELD:REGION=WEIGHT")
    if match[3] is None:
        return Part(match[1], match[2] or "")
    try:
        weight = float(match[3])
    except ValueError:
        weight = math.nan
    if not 0 <= weight <= 1:
        raise ValueError(f"--of {text}: a weight is a number of 0 to 1, not {match[3]!r}")
    return Part(match[1], match[2] or "", weight)


def text_of(part: Part) -> str:
    """Write a part as part_of reads it."""
    where = f":{part.region}" if part.region else ""
    return f"{part.field}{where}" + ("" if part.weight is None else f"={part.weight!r}")


def _weighed(parts: list[Part]) -> tuple[Part, ...]:
    """Return the parts, each with a weight; ValueError where the weights cannot be those of a blend."""
    for (name, region), count in Counter((part.field, part.region) for part in parts).items():
        if count > 1:
            raise ValueError(f"--of names {name}{f':{region}' if region else ''} {count} times; give it one weight")
    whole = [part for part in parts if not part.region]
    given = sum(part.weight for part in whole if part.weight is not None)
    if given > 1 + ROUNDING:
        raise ValueError(f"the weights of --of add up to {given:g}; at most 1 is allowed")
    waiting = [part for part in whole if part.weight is None]
    if waiting and given >= 1:
        raise ValueError(f"--of {waiting[0].field}: the other weights add up to 1; give it one too")
    if len(parts) == 1 and waiting:
        raise ValueError(
            f"--of {parts[0].field} alone is not a blend; give a weight below 1, a region or a second field"
        )
    rest = (1 - given) / max(len(waiting), 1)
    return tuple(
        part if part.weight is not None else Part(part.field, part.region, 1.0 if part.region else rest)
        for part in parts
    )
