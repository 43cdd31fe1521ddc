"""The capacity of a field's parts: one description that every kind interprets, so that one search serves all kinds."""

from dataclasses import dataclass

import numpy as np

from stylerf.fields.occupancy_grid import OccupancyGrid


@dataclass(frozen=True)
class Capacity:
    """The size of a part.

    Attributes:
        size: [3] vertices per axis of grids and planes.
        resolution: their mean, and the most cells per side of a hash level.
        density_rank, color_rank: ranks of vm parts.
        table: most vertices of a hash level. levels: number of hash levels. finest: cells per side of the finest one.
        occupancy: selects the blocks that a voxel grid allocates (None: all) and weights the pruning of ranks.
        degree: of the color's spherical harmonics.
    """

    size: np.ndarray
    resolution: int
    density_rank: int = 16
    color_rank: int = 24
    table: int = 1 << 16
    levels: int = 8
    finest: int = 256
    occupancy: OccupancyGrid | None = None
    degree: int = 1
