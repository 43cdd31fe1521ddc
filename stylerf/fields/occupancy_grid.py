"""Where a field may have density: a grid of cells over the unit cube that lets rays leap over empty space.

Each cell keeps a decaying maximum of the densities seen in it (Instant-NGP, Mueller et al. 2022, appendix C). A cell is
occupied where a step through it would be more than a hundredth opaque. `distances` holds, per cell, 0 where occupied,
else the Chebyshev distance to the nearest occupied cell.
"""

import numpy as np
from scipy.ndimage import distance_transform_cdt

from stylerf import validation
from stylerf.errors import InvalidValue
from stylerf.kernels.cpu.march import OPTICAL_SCALE

OPAQUE_STEP = 0.01
UNSEEN = np.inf  # in place of the density of a cell that nobody has looked at
MARK = 1e4  # the same in files of before
DENSEST = 9999.0  # of what was seen no more is kept
MOST_CELLS = 1024  # per axis


class OccupancyGrid:
    """cells: resolution per axis. highest: decaying maximum of raw density, [cells^3] float32.

    clear: cells [cells^3] bool that are known to be empty, whatever a field says of them: never looked at or occupied.
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
        """From a field's description and arrays."""
        highest = validation.array(arrays, "occupancy.highest", np.float32, (cells**3,), most=None)
        if not (highest >= 0).all():  # infinity stands for what nobody has looked at
            raise InvalidValue("the array occupancy.highest holds NaN, or a density below 0")
        made = OccupancyGrid(cells, highest)
        made.distances = validation.array(arrays, "occupancy.distances", np.uint8, (cells**3,))
        _check_distances(made.distances.reshape((cells,) * 3))
        return made

    def refresh(self, density, step: float, seed: int, share: int, decay: float) -> None:
        """Look at one cell in `share` (plus, when share > 1, nothing else), then decide what is occupied.

        density: callable of warped points [n, 3] -> raw density. seed: decides the cells and the points in them.
        """
        generator = np.random.default_rng(seed)
        start = int(generator.integers(share))
        index = np.arange(start, self.cells**3, share)
        if self.clear is not None:
            index = index[~self.clear[index]]
        corner = np.stack(np.unravel_index(index, (self.cells,) * 3), -1).astype(np.float32)
        points = (corner + generator.random(corner.shape, dtype=np.float32)) / np.float32(self.cells)
        seen = np.minimum(density(np.ascontiguousarray(points)), DENSEST)
        old = self.highest[index]
        self.highest[index] = np.maximum(np.where(old == UNSEEN, 0, old * np.float32(decay)), seen)
        self.decide(step)

    def decide(self, step: float) -> None:
        """Recompute `distances` for rays of step `step` (cube units)."""
        least = -np.log1p(-OPAQUE_STEP) / (float(OPTICAL_SCALE) * step)
        # Never let a young, thin field vanish as a whole: its mean is still worth a look.
        occupied = self.highest > min(least, float(np.mean(np.minimum(self.highest, MARK))))
        self.set_occupied(occupied)

    def set_occupied(self, occupied: np.ndarray) -> None:
        """Recompute `distances` for these cells [cells^3] bool, those known to be clear left out."""
        if self.clear is not None:
            occupied = occupied & ~self.clear
        grid = ~occupied.reshape((self.cells,) * 3)
        if grid.all():
            self.distances = np.full(self.cells**3, 255, np.uint8)
            return
        distance = distance_transform_cdt(grid, metric="chessboard")
        self.distances = np.minimum(distance, 255).astype(np.uint8).ravel()

    @property
    def share(self) -> float:
        """Occupied share of the cells."""
        return float(np.mean(self.distances == 0))

    def resized(self, cells: int) -> "OccupancyGrid":
        """The same knowledge on a grid a whole multiple finer."""
        grown = OccupancyGrid(cells, self._spread(self.highest, cells))
        grown.clear = None if self.clear is None else self._spread(self.clear, cells)
        grown.set_occupied(self._spread(self.distances == 0, cells))
        return grown

    def _spread(self, values: np.ndarray, cells: int) -> np.ndarray:
        """Values of cells on the finer grid."""
        grid = values.reshape((self.cells,) * 3)
        for axis in range(3):
            grid = np.repeat(grid, cells // self.cells, axis=axis)
        return np.ascontiguousarray(grid.ravel())


def _check_distances(distances: np.ndarray) -> None:
    """InvalidValue where a cell [s, s, s] says that it is farther from what is occupied than its neighbors allow.

    Chebyshev distances of neighbors, diagonal ones too, differ by 1 at most. One that is too large would have rays
    leap over what is occupied; one that is too small (those of a GPU end at 32) costs steps, no more.
    """
    least = distances
    for axis in range(3):
        along = np.moveaxis(least, axis, 0)
        least = least.copy()
        to = np.moveaxis(least, axis, 0)
        np.minimum(to[1:], along[:-1], out=to[1:])
        np.minimum(to[:-1], along[1:], out=to[:-1])
    if (distances > np.minimum(least, 254) + 1).any():
        raise InvalidValue("the array occupancy.distances holds what are no distances to occupied cells")


def _marked(highest: np.ndarray) -> np.ndarray:
    """These densities, with the present mark where an older file has its own."""
    return np.where(highest >= MARK, UNSEEN, highest)
