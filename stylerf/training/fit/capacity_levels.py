"""The capacity levels of a fit, and the field's parts at each, of any kind."""

from dataclasses import dataclass, replace

import numpy as np

from stylerf.fields.encoded_color import EncodedColor
from stylerf.fields.hash_grid import HashDensity
from stylerf.fields.occupancy_grid import OccupancyGrid
from stylerf.fields.protocol import Capacity
from stylerf.fields.vm import VmColor, VmDensity
from stylerf.fields.voxel import VoxelDensity
from stylerf.geometry.space_warp import SpaceWarp


@dataclass(frozen=True)
class CapacityLevel:
    """One capacity.

    Attributes:
        resolution: Vertices per axis of a cubic box (hash grid: most cells per side).
        density_rank, color_rank: Ranks of vm parts.
        cells: Cells per side of the occupancy grid.
        table_bits: log2 of a hash level's entries.
        degree: Highest degree of a vm color's spherical harmonics.
        color_resolution: Resolution of the color, 0 if it is the density's.
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
    """Kinds of a field's parts: density and color vm, hash or voxel; head linear or mlp. hash_levels: of hash grids."""

    density: str = "vm"
    color: str = "vm"
    head: str = "linear"
    hash_levels: int = 8


# Few ranks at first: ranks added later start where the error is. On the finest grid, a density with half the ranks and
# a coarser color hold as much, and steps take less time (decision 0040).
LEVELS = (
    CapacityLevel(64, 8, 16, table_bits=16),
    CapacityLevel(128, table_bits=17),
    CapacityLevel(192, table_bits=17),
    CapacityLevel(256, 8, table_bits=18, color_resolution=176),
)
# With colors as fine as the density, for photos of an object that hold more detail than the last of LEVELS.
FULL = CapacityLevel(256, 8, table_bits=18)
# A contraction spends half of each axis on the center, where a finer density still helps.
BEYOND = CapacityLevel(384, 8, table_bits=18, color_resolution=256)


def levels_for(kinds: Kinds, space: str, pixels: int) -> tuple[CapacityLevel, ...]:
    """The levels that a fit tries. space: kind of its warp. pixels: longest side of the photos."""
    if kinds.head != "linear":
        # The network behind the color has one width, so that the first level needs all ranks.
        return (replace(LEVELS[0], color_rank=FULL.color_rank), *LEVELS[1:3], FULL)
    if kinds == Kinds() and space == "contraction":
        # All ranks until the last: 256^3 with half of them seems to gain nothing, although 384^3 then would.
        return (*LEVELS[:3], replace(FULL, density_rank=16), BEYOND)
    lean = kinds == Kinds() and (space == "frustum" or pixels < 2 * LEVELS[-1].color_resolution)
    return LEVELS if lean else (*LEVELS[:3], FULL)


def capacity_at(
    level: CapacityLevel,
    finest: int,
    hash_levels: int,
    space: SpaceWarp,
    occupancy: OccupancyGrid | None = None,
    degree: int = 1,
) -> Capacity:
    """A level's capacity in a space. finest: resolution of the last level. degree: the highest wanted."""
    return Capacity(
        space.cells_per_axis(level.resolution),
        level.resolution,
        level.density_rank,
        level.color_rank,
        1 << level.table_bits,
        hash_levels,
        finest,
        occupancy,
        min(level.degree, degree),
    )


def first_parts(kinds: Kinds, capacity: Capacity, generator: np.random.Generator) -> tuple:
    """Initial (density, color)."""
    degree = capacity.degree
    if kinds.density == "vm":
        density = VmDensity.create(capacity.size, capacity.density_rank, generator)
    else:
        density = DENSITIES[kinds.density].create(capacity, generator)
    if kinds.color == "vm" and kinds.head == "linear":
        return density, VmColor.create(capacity.size, capacity.color_rank, degree, generator)
    return density, EncodedColor.create(kinds.color, kinds.head, capacity, degree, generator)


DENSITIES = {"hash": HashDensity, "voxel": VoxelDensity}
