"""Success rates by cell: one method under one fault, over all seeds."""

import math
import statistics
from collections.abc import Sequence
from dataclasses import asdict, dataclass

from stages.configs.faults import FAULTS, METHODS

REMEDIED, REMEDIED_FILE = " + remedies", "-remedied"  # in labels; in file names


@dataclass(frozen=True)
class Outcome:
    """One run.

    key: digest of everything that affects the result. score: None without a picture or with non-finite values. why:
    reason of a failure. picture: file name of the worst view.
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
