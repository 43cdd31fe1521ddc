"""Options of `stylerf stress`."""

from dataclasses import dataclass
from typing import TypedDict

from stages.configs import advanced, option
from stages.configs.faults import FAULTS, METHODS
from stages.configs.fit import budget_of


class Conditions(TypedDict):
    """What all trials share. Budgets are a time or a number of steps."""

    seeds: int
    budget: str
    style_budget: str
    side: int
    views: int
    tests: int
    quick: bool


@dataclass(frozen=True)
class StressConfig:
    """Methods, faults, repetitions, budgets and sizes."""

    methods: tuple[str, ...] = option(
        ("fit", "arf"), metavar="METHOD", help=f"methods to test: {', '.join(METHODS)}, or all"
    )
    faults: tuple[str, ...] = option(("all",), metavar="FAULT", help=f"faults to inject: {', '.join(FAULTS)}, or all")
    seeds: int = option(0, help="runs of each cell, with consecutive seeds from --seed (0: 5, with --quick 2)")
    budget: str = option("", help="training time of each fit, or steps (default: 20s, with --quick 150 steps)")
    style_budget: str = option(
        "", help="time of each stylization or edit, or steps (default: --budget, with --quick 15 steps, 60 for edits)"
    )
    side: int = advanced(
        0, help="longer side of the photos, pixels; larger ones are downscaled (0: 160, with --quick 64)"
    )
    remedies: str = option("off", choices=("off", "on", "both"), help="run without remedies, with them, or both")
    quick: bool = option(False, help="run fewer, smaller and shorter trials")
    keep: bool = advanced(False, help="keep the scenes and fields of all trials in WORK/stress/works")

    def __post_init__(self) -> None:
        for name, known in (("methods", METHODS), ("faults", FAULTS)):
            unknown = [one for one in getattr(self, name) if one != "all" and one not in known]
            if unknown:
                raise ValueError(f"unknown {name[:-1]} {unknown[0]!r}; choose from {', '.join(known)}, or all")
        for budget in (self.budget, self.style_budget):
            if budget:
                budget_of(budget)
        if self.seeds < 0 or (self.side and not 32 <= self.side <= 4096):
            raise ValueError("seeds must not be negative, side 32 to 4096")

    @property
    def chosen_methods(self) -> list[str]:
        """Their names, in the order of the table."""
        return [name for name in METHODS if name in self.methods or "all" in self.methods]

    @property
    def chosen_faults(self) -> list[str]:
        """Their names, in the order of the table."""
        return [name for name in FAULTS if name in self.faults or "all" in self.faults]

    @property
    def conditions(self) -> Conditions:
        """What all trials share, and what a baseline must share with them."""
        quick = self.quick
        budget = self.budget or ("150" if quick else "20s")
        return {
            "seeds": self.seeds or (2 if quick else 5),
            "budget": budget,
            "style_budget": self.style_budget or ("15" if quick else budget),
            "side": self.side or (64 if quick else 160),
            "views": 12 if quick else 24,
            "tests": 2 if quick else 4,
            "quick": quick,
        }
