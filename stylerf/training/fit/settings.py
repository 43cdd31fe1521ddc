"""Settings of a fit: the capacity levels, the options, and the state of a run."""

import math
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Protocol, Self, runtime_checkable

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.fields.encoded_color import EncodedColor
from stylerf.fields.hash_grid import HashDensity
from stylerf.fields.occupancy_grid import OccupancyGrid
from stylerf.fields.protocol import Capacity, ColorPart, DensityPart, Growing
from stylerf.fields.radiance_field import RadianceField
from stylerf.fields.vm import VmColor, VmDensity
from stylerf.fields.voxel import VoxelDensity
from stylerf.geometry.space_warp import SpaceWarp


@runtime_checkable
class GrowingDensity(DensityPart, Growing, Protocol):
    def grown(self, capacity: Capacity, generator: np.random.Generator) -> Self: ...


@runtime_checkable
class GrowingColor(ColorPart, Growing, Protocol):
    def grown(self, capacity: Capacity, generator: np.random.Generator) -> Self: ...


@dataclass(frozen=True)
class CapacityLevel:
    """One capacity.

    Attributes:
        resolution: Vertices per axis of a cubic box (hash grid: maximum cells per side).
        density_rank, color_rank: Ranks of vm parts.
        cells: Cells per side of the occupancy grid.
        table_bits: log2 of a hash level's entries.
        degree: Highest degree of a vm color's spherical harmonics.
        color_resolution: Resolution of the color; 0: the density's.
    """

    resolution: int
    density_rank: int = 16
    color_rank: int = 24
    cells: int = 64
    table_bits: int = 16
    degree: int = 2
    color_resolution: int = 0

    @property
    def color(self) -> "CapacityLevel":
        """The capacity of the color, which may be coarser than the density."""
        return replace(self, resolution=self.color_resolution or self.resolution)


@dataclass(frozen=True)
class Kinds:
    """Kinds of a field's parts. density, color: vm, hash or voxel. head: linear or mlp. hash_levels: of hash grids."""

    density: str = "vm"
    color: str = "vm"
    head: str = "linear"
    hash_levels: int = 8


# Few ranks at first: ranks added later start where the error is. On the finest grid, a density with half the ranks and
# a coarser color are just as good, and steps take less time (decision 0040).
LEVELS = (
    CapacityLevel(64, 8, 16, table_bits=16),
    CapacityLevel(128, table_bits=17),
    CapacityLevel(192, table_bits=17),
    CapacityLevel(256, 8, table_bits=18, color_resolution=176),
)
# With colors as fine as the density, for photos of an object with more detail than the last of LEVELS can represent.
FULL = CapacityLevel(256, 8, table_bits=18)
# For photos of an object with more detail than FULL can represent: 1 dB on lego at 800x800 after 300 s (decision 0040).
LARGE = CapacityLevel(384, table_bits=18)
# A contraction spends half of each axis on the center, where a finer density still helps. BRIEF: for short budgets.
BEYOND = CapacityLevel(384, 8, table_bits=18)
BEYOND_BRIEF = replace(BEYOND, color_resolution=256)

# The last level of a forward-facing capture, with finer colors than FULL (decision 0067). SHARP: for photos with more
# detail (decision 0055).
FINE = replace(FULL, color_resolution=352)
SHARP = replace(FULL, color_resolution=480)

# Cells per side of a capture's occupancy grid, for levels of at least this resolution.
CAPTURE_CELLS, FINER_FROM = 128, 192


def levels_for(kinds: Kinds, space: str, pixels: int, brief: bool = False) -> tuple[CapacityLevel, ...]:
    """Return the levels that a fit tries.

    Args:
        kinds: Of the field's parts.
        space: Kind of its space warp.
        pixels: Longest side of the photos.
        brief: Whether the budget is too short for the finest colors of a capture.
    """
    if kinds.head != "linear":
        # The color's MLP head has a fixed input width, so the first level needs all ranks.
        return (replace(LEVELS[0], color_rank=FULL.color_rank), *LEVELS[1:3], FULL)
    if kinds == Kinds() and space == "contraction":
        # 256^3 appears to gain nothing, although 384^3 would (decision 0060).
        return (*LEVELS[:3], BEYOND_BRIEF if brief else BEYOND)
    if kinds.color == "vm" and space == "frustum" and pixels >= 3 * FULL.resolution:
        return (*LEVELS[:3], FULL, SHARP)
    if kinds == Kinds("hash") and space == "frustum" and not brief:
        return (*LEVELS[:3], FULL, FINE)
    if kinds == Kinds() and space == "box" and pixels >= 2 * FULL.resolution:
        return (*LEVELS[:3], FULL, LARGE)
    lean = kinds == Kinds() and (space == "frustum" or pixels < 2 * LEVELS[-1].color_resolution)
    return LEVELS if lean else (*LEVELS[:3], FULL)


def cells_for(levels: tuple[CapacityLevel, ...], space: str) -> tuple[CapacityLevel, ...]:
    """Return levels with a finer occupancy grid from FINER_FROM on for captures: rays skip more (decision 0047)."""
    if space == "box":
        return levels
    return tuple(replace(level, cells=CAPTURE_CELLS) if level.resolution >= FINER_FROM else level for level in levels)


def capacities_at(
    level: CapacityLevel,
    finest: int,
    hash_levels: int,
    space: SpaceWarp,
    occupancy: OccupancyGrid | None = None,
    degree: int = 1,
) -> tuple[Capacity, Capacity]:
    """Return a level's capacities (density, color) in a space.

    finest: resolution of the last level. degree: maximum degree of the spherical harmonics.
    """

    def of(part: CapacityLevel, size: np.ndarray) -> Capacity:
        return Capacity(
            size,
            part.resolution,
            part.density_rank,
            part.color_rank,
            1 << part.table_bits,
            hash_levels,
            finest,
            occupancy,
            min(part.degree, degree),
        )

    color = level.color
    return of(level, space.cells_per_axis(level.resolution)), of(color, space.color_cells(color.resolution))


def first_parts(
    kinds: Kinds, density: Capacity, color: Capacity, generator: np.random.Generator
) -> tuple[GrowingDensity, GrowingColor]:
    """Return the initial (density, color) with these capacities."""
    first: GrowingDensity
    if kinds.density == "vm":
        first = VmDensity.create(density.size, density.density_rank, generator)
    elif kinds.density == "hash":
        first = HashDensity.create(density, generator)
    else:
        first = VoxelDensity.create(density, generator)
    if kinds.color == "vm" and kinds.head == "linear":
        return first, VmColor.create(color.size, color.color_rank, color.degree, generator)
    return first, EncodedColor.create(kinds.color, kinds.head, color, color.degree, generator)


def grown_parts(
    field: RadianceField, density: Capacity, color: Capacity, generator: np.random.Generator
) -> tuple[GrowingDensity, GrowingColor]:
    """Return (density, color) of a field, grown to these capacities."""
    if not (isinstance(field.density, GrowingDensity) and isinstance(field.color, GrowingColor)):
        raise InvalidValue(
            f"a field with {field.density.kind} density and {field.color.kind} color cannot change its size"
        )
    return field.density.grown(density, generator), field.color.grown(color, generator)


@dataclass(frozen=True)
class FitSettings:
    """Settings of a fit.

    Attributes:
        seconds, steps: Budget: time, or steps if positive.
        samples: Density samples per step; the number of rays is adjusted to it, so early fog does not slow steps down.
        rate: Learning rate in value units per step; decays by the factor `final_rate`.
        smoothness: Weights of the planes' total variation (density, color).
        near_scaling_distance: Distance, scene units, below which gradients of samples are scaled by the squared
            distance, to avoid floaters at the cameras; 0: never.
        kinds: Of the field's parts.
        levels: Capacities to try, coarse to fine.
        level_ends: Fractions of the budget at which the trial of the next level begins, and that of the last ends.
        level_max_steps: Step, counted from the start, by which each level ends; empty: no limit.
        held_out_until: Fraction of the budget from which held-out views are trained on as well, unless everything is
            decided earlier (1: never).
        prunings: What to try to prune after growth (capacity_search.PRUNINGS).
        min_gain: Gain of held-out views in dB required for a larger field.
        background: white, black, random or none.
        lit_share: Fraction of rays through pixels near objects.
        force_growth: Use every level, regardless of its gain.
        opacity: Final weight of the opacity prior (engine.opacity_gradient). It rises from 0 after the first quarter of
            the budget, so that it cannot suppress what has not appeared yet.
        visual_hull: Fraction of the training views that must show a cell of a box as empty, by their alpha, to exclude
            it (visual_hull.clear_cells; 0: exclude none).
        coverage: Weight of the squared error of alpha relative to that of colors, for cut-out photos.
        distortion: Final weight of the distortion loss (kernels/cpu/compositing.distortion_backward), which
            concentrates a ray's weight at one depth. It rises from 0 between DISTORTION_FROM and DISTORTION_FULL of the
            budget, once colors have formed.
        least_weight: Weight that a sample of a training ray needs to keep its cell; cells without any for a long time
            are emptied (seen_cells.py; 0: none).
        overshoot: Factors of distortion and of least_weight in the first half of the budget; then they fall to 1.
        exposure: on, off, or auto: correct photos to a common exposure if they clearly differ (exposure.py).
    """

    seconds: float = 300.0
    steps: int = 0
    samples: int = 90_000
    rate: float = 2e-2
    final_rate: float = 0.05
    degree: int = 1
    smoothness: tuple[float, float] = (0.0, 0.0)
    near_scaling_distance: float = 0.0
    kinds: Kinds = field(default_factory=Kinds)
    levels: tuple[CapacityLevel, ...] = LEVELS
    level_ends: tuple[float, ...] = (0.1, 0.22, 0.38, 0.55)
    level_max_steps: tuple[int, ...] = ()
    held_out_until: float = 0.75
    prunings: tuple[str, ...] = ("density ranks", "resolution", "color ranks", "color resolution", "degree")
    min_gain: float = 0.1
    background: str = "white"
    lit_share: float = 0.9
    force_growth: bool = False
    opacity: float = 0.0
    visual_hull: float = 0.0
    coverage: float = 0.0
    distortion: float = 0.0
    least_weight: float = 0.0
    overshoot: tuple[float, float] = (1.0, 1.0)
    exposure: str = "off"


@dataclass
class Trial:
    """A level on trial.

    Attributes:
        before: Quality of the previous field, dB.
        level, parameters: Capacity and number of parameters of the previous field.
        began_at, extended_until: Progress at which the trial began, and to which it is extended.
    """

    before: float
    level: CapacityLevel
    parameters: int
    began_at: float
    extended_until: float = 0.0


@dataclass
class FitState:
    """The state in a checkpoint, apart from arrays."""

    step: int = 0
    seconds: float = 0.0
    level: int = 0
    growth_ended: bool = False
    pruned: dict[str, int] = field(default_factory=dict)  # changed attributes of the level
    level_gain: float | None = None  # dB gained by the current level in its trial; None: no growth
    decided: bool = False  # nothing is left to try
    rejected: list[str] = field(default_factory=list)  # prunings that cost too much quality
    unpruned: float | None = None  # best held-out dB before any pruning
    trial: Trial | None = None
    sizes: list[dict] = field(default_factory=list)  # effect of each change of size
    rate_scale: float = 1.0
    rollbacks: int = 0
    parts: int = 1
    rays: int = 1024
    drawn: int = 0  # number of rays in all previous steps
    best: float = -math.inf
    quality: dict[str, float] = field(default_factory=dict)  # dB of the field, on views `held out` and `trained on`
    anchor_quality: dict[str, float] = field(default_factory=dict)  # the same for the anchor
    ended_at: float | None = None  # fraction of the budget at which rollbacks ran out
    curve: list[dict] = field(default_factory=list)
    decisions: list[str] = field(default_factory=list)
    refreshed_at: float = 0.0  # progress at the last update of the occupancy grid
    stops: list[float] | None = None  # overexposure of the photos; empty: all equal; None: not estimated

    def shift(self, by: float) -> None:
        """Add `by`, dB, to all qualities: correcting photos would otherwise look like a loss or a gain."""
        self.best += by
        for known in (self.quality, self.anchor_quality):
            known.update({views: round(value + by, 3) for views, value in known.items()})
        if self.unpruned is not None:
            self.unpruned += by
        if self.trial is not None:
            self.trial.before += by

    def as_json(self) -> dict[str, Any]:
        """Return a JSON value."""
        return asdict(self) | {"best": self.best if math.isfinite(self.best) else None}

    @staticmethod
    def from_json(data: dict[str, Any]) -> "FitState":
        """Restore the state from as_json()."""
        state = FitState(**data)
        state.best = -math.inf if state.best is None else state.best
        if data["trial"] is not None:
            state.trial = Trial(**data["trial"] | {"level": CapacityLevel(**data["trial"]["level"])})
        return state
