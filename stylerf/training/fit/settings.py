"""How a field is fitted, and where a fit stands."""

import math
from dataclasses import dataclass, field

from stylerf.training.fit.capacity_levels import LADDER, CapacityLevel, Kinds


@dataclass(frozen=True)
class FitSettings:
    """How a field is fitted. kinds: what it is made of. Budget: seconds of training, or steps if `steps` > 0.

    samples: density samples a step; the number of rays follows, so that fog early on does not slow the steps down;
    rates in value units per step; smoothness: weights of the planes' total variation (density, color); even_from:
    distance, scene units, below which samples learn by the square of their distance, against floaters (0: all alike);
    shares: parts of the budget at which the trial of the next rung begins, and that of the last ends, at the latest
    after so many steps in all (`longest`, of every rung; empty: however many those are);
    reductions: what is tried to be given up then (climbing.REDUCTIONS); held_out_until: part of the budget from which
    the held-out views are trained on as well, unless nothing is left to decide before that (1: never).
    opacity: weight of the opacity prior (engine.opacity_gradient) at the end of the budget, growing from nothing in its
    first quarter, so that it cannot forbid what is yet to appear.
    hull: share of the training views that must show a cell of a box as clear, by their transparency, for nothing to be
    looked for there (hull.clear_cells; 0: everywhere is). coverage: weight of the squared error of alpha
    (engine.coverage_gradient) beside that of the colors, where photos are cut out. exposure: whether photos are
    brought to one exposure (exposure.py).
    """

    seconds: float = 300.0
    steps: int = 0
    samples: int = 90_000
    rate: float = 2e-2
    final_rate: float = 0.05
    degree: int = 1
    smoothness: tuple[float, float] = (0.0, 0.0)
    even_from: float = 0.0
    kinds: Kinds = field(default_factory=Kinds)
    ladder: tuple[CapacityLevel, ...] = LADDER
    shares: tuple[float, ...] = (0.1, 0.22, 0.38, 0.55)
    longest: tuple[int, ...] = ()
    held_out_until: float = 0.75
    reductions: tuple[str, ...] = ("density ranks", "resolution", "color ranks", "color resolution", "degree")
    min_gain: float = 0.1
    background: str = "white"  # white, black, random or none
    lit_share: float = 0.9
    always_climb: bool = False  # take every rung whatever it gains
    opacity: float = 0.0
    hull: float = 0.0
    coverage: float = 0.0
    exposure: str = "off"  # on, off, or auto: where photos differ plainly


@dataclass
class FitState:
    """Everything a checkpoint holds beside the arrays."""

    step: int = 0
    seconds: float = 0.0
    rung: int = 0
    fixed: bool = False  # the ladder has been left: no more growth
    given_up: dict[str, int] = field(default_factory=dict)  # of the rung, by its fields' names
    climbed: float | None = None  # dB by which the present rung was kept; None: no rung was climbed
    decided: bool = False  # nothing more is to be tried
    refused: list[str] = field(default_factory=list)  # reductions that lost too much
    whole: float | None = None  # the best held-out dB from which anything was given up
    trial: dict | None = None  # see climbing.Climb
    sizes: list[dict] = field(default_factory=list)  # what each change of size brought
    rate_scale: float = 1.0
    rollbacks: int = 0
    parts: int = 1
    rays: int = 1024
    best: float = -math.inf
    stands: dict[str, float] = field(default_factory=dict)  # dB of what stands, of views `held out` and `trained on`
    anchored: dict[str, float] = field(default_factory=dict)  # the same of what a return leads to
    ended_at: float | None = None  # part of the budget after which no more returns were left
    curve: list[dict] = field(default_factory=list)
    decisions: list[str] = field(default_factory=list)
    stops: list[float] | None = None  # by which photos are overexposed; empty: all alike; None: not judged
