"""Options of `stylerf stress`."""

from dataclasses import dataclass

from stages.configs import option
from stages.configs.faults import FAULTS, METHODS
from stages.configs.fit import budget_of


@dataclass(frozen=True)
class StressConfig:
    """Which methods face which faults, how often, how long, how large."""

    methods: tuple[str, ...] = option(("fit", "arf"), metavar="METHOD", help=f"of {', '.join(METHODS)}, or all")
    faults: tuple[str, ...] = option(("all",), metavar="FAULT", help=f"of {', '.join(FAULTS)}, or all")
    seeds: int = option(0, help="runs of each cell, with seeds that follow --seed (0: 5; --quick: 2)")
    budget: str = option("", help="of each fit, time or steps (default: 20s; --quick: 150 steps)")
    style_budget: str = option(
        "",
        help="of each stylization and palettenerf; of LAENeRF's edits a time is that of learning and again that of "
        "fine-tuning, steps are those of fine-tuning (default: that of the fits; --quick: 15 steps, of edits 60)",
    )
    side: int = option(0, help="longer side of the photos, pixels; larger ones are averaged down (0: 160; --quick: 64)")
    remedies: str = option(
        "off", choices=("off", "on", "both"), help="run without remedies, with them, or both for before and after"
    )
    quick: bool = option(False, help="small, short and few: does anything fail at all")
    keep: bool = option(False, help="keep scenes and fields of every run below WORK/stress/works")

    def __post_init__(self) -> None:
        for name, known in (("methods", METHODS), ("faults", FAULTS)):
            unknown = [one for one in getattr(self, name) if one != "all" and one not in known]
            if unknown:
                raise ValueError(f"there is no {name[:-1]} {unknown[0]!r}; there are {', '.join(known)}, or all")
        for budget in (self.budget, self.style_budget):
            if budget:
                budget_of(budget)
        if self.seeds < 0 or (self.side and not 32 <= self.side <= 4096):
            raise ValueError("seeds must not be negative, side 32 to 4096")

    @property
    def chosen_methods(self) -> list[str]:
        """Names in the order of the table, each once."""
        return [name for name in METHODS if name in self.methods or "all" in self.methods]

    @property
    def chosen_faults(self) -> list[str]:
        """Names in the order of the table, each once."""
        return [name for name in FAULTS if name in self.faults or "all" in self.faults]

    @property
    def conditions(self) -> dict[str, object]:
        """What all runs share and a baseline must share with them."""
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
