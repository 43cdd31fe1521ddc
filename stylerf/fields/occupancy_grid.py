"""Occupancy grid: where a field may have density, and how far rays can skip through empty space.

Each cell keeps a decaying maximum of the densities evaluated in it (Instant-NGP, Mueller et al. 2022, appendix C). A
cell is occupied if one step through it would have an alpha above 0.01. `distances` holds, per cell, the Chebyshev
distance to the nearest occupied cell (0: occupied).
"""

import numpy as np

from stylerf import validation
from stylerf.errors import InvalidValue
from stylerf.kernels.cpu.march import OPTICAL_SCALE
from stylerf.kernels.cpu.occupancy import chebyshev_distances

OPAQUE_STEP = 0.01
UNSEEN = np.inf  # density of a cell that has not been evaluated yet, which counts as occupied
MARK = 1e4  # UNSEEN in older files
DENSEST = 9999.0  # densities are clamped to this, below MARK
MAX_CELLS = 1024  # per axis


class OccupancyGrid:
    """An occupancy grid over the unit cube.

    Attributes:
        cells: resolution per axis.
        highest: [cells^3] float32, decaying maximum of raw density.
        distances: [cells^3] uint8, Chebyshev distance to the nearest occupied cell, in cells; 0: occupied.
        clear: [cells^3] bool, cells treated as empty regardless of the field's density (None: none).
    """

    def __init__(self, cells: int, highest: np.ndarray | None = None, clear: np.ndarray | None = None) -> None:
        self.cells, self.clear = cells, clear
        self.highest = np.full(cells**3, UNSEEN, np.float32) if highest is None else _marked(highest)
        self.distances = np.zeros(cells**3, np.uint8)
        if clear is not None:
            self.highest[clear] = 0
            self.set_occupied(~clear)

    @staticmethod
    def restore(cells: int, arrays: dict[str, np.ndarray]) -> "OccupancyGrid":
        """Rebuild a grid from a field's arrays; raises InvalidValue if they are not a valid grid."""
        highest = validation.array(arrays, "occupancy.highest", np.float32, (cells**3,), most=None)
        if not (highest >= 0).all():  # infinity: never evaluated
            raise InvalidValue("the array occupancy.highest holds NaN or a negative density")
        made = OccupancyGrid(cells, highest)
        made.distances = validation.array(arrays, "occupancy.distances", np.uint8, (cells**3,))
        _check_distances(made.distances.reshape((cells,) * 3))
        return made

    def refresh(self, density, step: float, seed: int, stride: int, decay: float) -> None:
        """Evaluate the density in every stride-th cell, then update which cells are occupied.

        Args:
            density: maps points [n, 3] in the cube to raw density [n].
            step: marching step, cube units.
            seed: determines the first cell and the point within each cell.
            decay: factor applied to the old maximum of each evaluated cell.
        """
        generator = np.random.default_rng(seed)
        start = int(generator.integers(stride))
        index = np.arange(start, self.cells**3, stride)
        if self.clear is not None:
            index = index[~self.clear[index]]
        corner = np.stack(np.unravel_index(index, (self.cells,) * 3), -1).astype(np.float32)
        points = (corner + generator.random(corner.shape, dtype=np.float32)) / np.float32(self.cells)
        seen = np.minimum(density(np.ascontiguousarray(points)), DENSEST)
        # UNSEEN is infinite and would survive any decay.
        old = self.highest[index]
        self.highest[index] = np.maximum(np.where(old == UNSEEN, 0, old * np.float32(decay)), seen)
        self.decide(step)

    def decide(self, step: float) -> None:
        """Recompute `distances` for a marching step (cube units)."""
        # 1 - exp(-OPTICAL_SCALE sigma step) = OPAQUE_STEP, solved for sigma.
        threshold = -np.log1p(-OPAQUE_STEP) / (float(OPTICAL_SCALE) * step)
        # The threshold never exceeds the mean density: early in training, a field may be below it everywhere. Clamping
        # to MARK keeps UNSEEN from making the mean infinite.
        occupied = self.highest > min(threshold, float(np.mean(np.minimum(self.highest, MARK))))
        self.set_occupied(occupied)

    def empty(self, clear: np.ndarray) -> None:
        """Set the cells to treat as empty, [cells^3] bool, and reset their densities."""
        self.clear = clear
        self.highest[clear] = 0

    def set_occupied(self, occupied: np.ndarray) -> None:
        """Recompute `distances` from occupied cells [cells^3] bool, except those in `clear`."""
        if self.clear is not None:
            occupied = occupied & ~self.clear
        grid = (self.cells,) * 3
        self.distances = np.empty(self.cells**3, np.uint8)
        chebyshev_distances(occupied.reshape(grid), self.distances.reshape(grid))

    @property
    def share(self) -> float:
        """Occupied fraction of the cells."""
        return float(np.mean(self.distances == 0))

    def resized(self, cells: int) -> "OccupancyGrid":
        """Return the grid at an integer multiple of its resolution."""
        grown = OccupancyGrid(cells, self._spread(self.highest, cells))
        grown.clear = None if self.clear is None else self._spread(self.clear, cells)
        grown.set_occupied(self._spread(self.distances == 0, cells))
        return grown

    def _spread(self, values: np.ndarray, cells: int) -> np.ndarray:
        """Repeat values of cells onto the finer grid."""
        grid = values.reshape((self.cells,) * 3)
        for axis in range(3):
            grid = np.repeat(grid, cells // self.cells, axis=axis)
        return np.ascontiguousarray(grid.ravel())


def _check_distances(distances: np.ndarray) -> None:
    """Raise InvalidValue if any distance [s, s, s] is larger than its neighbors allow.

    Chebyshev distances of neighbors, including diagonal ones, differ by at most 1. A distance that is too large would
    let rays skip occupied cells; one that is too small (GPUs clamp at 32) only costs steps.
    """
    # The minimum over the 3^3 neighborhood, one axis at a time.
    lowest = distances
    for axis in range(3):
        along = np.moveaxis(lowest, axis, 0)
        lowest = lowest.copy()
        to = np.moveaxis(lowest, axis, 0)
        np.minimum(to[1:], along[:-1], out=to[1:])
        np.minimum(to[:-1], along[1:], out=to[:-1])
    # 254, since 255 + 1 is 0 in uint8.
    if (distances > np.minimum(lowest, 254) + 1).any():
        raise InvalidValue("the array occupancy.distances does not hold distances to occupied cells")


def _marked(highest: np.ndarray) -> np.ndarray:
    """Return densities with MARK, which older files use, replaced by UNSEEN."""
    return np.where(highest >= MARK, UNSEEN, highest)
