"""Outcomes of trials, one file each, so that an interrupted command resumes; and the success rates of cells."""

import math
import statistics
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from schemas.atomic_write import write_json
from schemas.errors import BadInput
from schemas.safe_names import file_name
from schemas.safe_reading import read_json
from stages.configs.faults import FAULTS, METHODS
from stages.evaluation.metrics import is_number

REMEDIED, REMEDIED_FILE = " + remedies", "-remedied"  # in labels; in file names


@dataclass(frozen=True)
class Outcome:
    """One run.

    key: digest of everything that affects the result. score: None without a picture or with non-finite values. why:
    reason for a failure. picture: file name of the worst view.
    """

    key: str
    method: str
    fault: str
    seed: int
    remedies: bool
    ok: bool
    why: str
    score: float | None
    figures: dict[str, float]
    seconds: float
    picture: str = ""

    @property
    def label(self) -> str:
        """The method, with or without remedies."""
        return self.method + (REMEDIED if self.remedies else "")

    @property
    def name(self) -> str:
        """The name of its files."""
        return run_name(f"{self.method}{REMEDIED_FILE if self.remedies else ''}", self.fault, self.seed, self.key)


def run_name(label: str, fault: str, seed: int, key: str) -> str:
    """Return the name of a run's files; part of the key keeps runs of different options apart."""
    return f"{label}--{fault}--{seed}--{key[:12]}"


@dataclass(frozen=True)
class Cell:
    """One method under one fault.

    median, spread (standard deviation, 1/(n-1)), lowest: of the scores that exist, else None. worst: the first outcome
    without a score, else the one with the lowest. whys: distinct reasons of failures.
    """

    method: str
    fault: str
    successes: int
    count: int
    median: float | None
    spread: float | None
    lowest: float | None
    seconds: float
    worst: Outcome
    whys: tuple[str, ...]

    @property
    def rate(self) -> float:
        """Share of successful runs."""
        return self.successes / self.count

    def as_json(self) -> dict:
        """Return plain numbers and text."""
        return asdict(self) | {"rate": self.rate}


def cells_of(outcomes: Sequence[Outcome]) -> list[Cell]:
    """Return a cell for each method and fault with outcomes, in the order of FAULTS and METHODS."""
    groups: dict[tuple[str, str], list[Outcome]] = {}
    for one in outcomes:
        groups.setdefault((one.label, one.fault), []).append(one)
    order = {name: place for place, name in enumerate((*METHODS, *FAULTS))}
    keys = sorted(groups, key=lambda key: (order[key[1]], order[key[0].removesuffix(REMEDIED)], key[0]))
    return [_cell(*key, sorted(groups[key], key=lambda one: one.seed)) for key in keys]


def _cell(method: str, fault: str, runs: list[Outcome]) -> Cell:
    scores = [one.score for one in runs if one.score is not None]
    return Cell(
        method=method,
        fault=fault,
        successes=sum(one.ok for one in runs),
        count=len(runs),
        median=statistics.median(scores) if scores else None,
        spread=statistics.stdev(scores) if len(scores) > 1 else None,
        lowest=min(scores, default=None),
        seconds=sum(one.seconds for one in runs),
        worst=min(runs, key=lambda one: -math.inf if one.score is None else one.score),
        whys=tuple(dict.fromkeys(one.why for one in runs if one.why)),
    )


FOLDER = "runs"
NOT_FINITE = ("inf", "-inf", "nan")  # as schemas.canonical_json writes them


def load_outcome(root: Path, run: str, key: str) -> Outcome | None:
    """Load the outcome of a run if its key matches; None if it is missing or damaged.

    The file is untrusted, so every value is checked, and the picture must be in its folder.
    """
    for name in (run, run.rpartition("--")[0]):  # older files have no key in their name
        try:
            found = _outcome(read_json(root / FOLDER / f"{name}.json"))
        except (OSError, BadInput):
            continue
        if found.key == key:
            return found
    return None


def _outcome(content: object) -> Outcome:
    if not isinstance(content, dict) or content.keys() != {item.name for item in fields(Outcome)}:
        raise BadInput("not the outcome of a stress run")
    found = Outcome(**content)
    texts = (found.key, found.method, found.fault, found.why, found.picture)
    flags = (found.remedies, found.ok)
    numbers = [found.seconds, *([] if found.score is None else [found.score])]
    sound = (
        all(isinstance(one, str) for one in texts)
        and all(isinstance(one, bool) for one in flags)
        and type(found.seed) is int
        and isinstance(found.figures, dict)
        and all(map(is_number, numbers))
        and all(is_number(one) or one in NOT_FINITE for one in content["figures"].values())
        and found.method in METHODS
        and found.fault in FAULTS
    )
    if not sound:
        raise BadInput("contains a value that no stress run writes")
    if found.picture:
        file_name(found.picture, "picture", BadInput)
    return found


def save_outcome(root: Path, outcome: Outcome) -> None:
    """Write an outcome atomically."""
    write_json(root / FOLDER / f"{outcome.name}.json", asdict(outcome))
