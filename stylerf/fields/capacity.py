"""How large a field's parts are: what each kind makes of one description, so that one ladder serves all of them."""

from dataclasses import dataclass

import numpy as np

from stylerf.fields.occupancy_grid import OccupancyGrid


@dataclass(frozen=True)
class Capacity:
    """size: vertices per axis, [3], of grids and planes; resolution: their mean, and the most cells of a hash level.

    density_rank, color_rank: of vm. table: vertices that a hash level keeps, of `levels` up to `finest` cells a side.
    occupancy: where something is: what a voxel grid keeps (None: it keeps all), what counts when ranks are given up.
    degree: of the spherical harmonics of the color.
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
