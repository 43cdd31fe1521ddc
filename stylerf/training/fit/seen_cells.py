"""Tracks in which cells of the occupancy grid training rays have recently seen something.

Density that gets no weight from any training ray explains no photo: it is inside or behind surfaces, or was left in
front of them when they formed. Marching through it takes time, and new views see it as haze.
"""

from typing import Self

import numpy as np
import torch
import torch.nn.functional as F

from stylerf import validation
from stylerf.training.common.process_group import SINGLE_PROCESS, ProcessGroup

PATIENCE = 0.15  # of the budget; a cell that is not seen for this long counts as empty


class SeenCells:
    """For each cell, how long ago a training ray has last seen something in it.

    Attributes:
        cells: Resolution of the grid per axis.
        marked: [cells^3] uint8, on `device`; 1 where a ray has seen something since the last update.
        ages: [cells^3] float32, fraction of the budget since a ray last did.
    """

    def __init__(self, cells: int, device: torch.device | str = "cpu") -> None:
        self.cells = cells
        self.marked = torch.zeros(cells**3, dtype=torch.uint8, device=device)
        self.ages = torch.zeros(cells**3, device=device)

    @classmethod
    def restore(cls, arrays: dict[str, np.ndarray], cells: int, device: torch.device | str = "cpu") -> Self | None:
        """Restore from arrays() with `cells` per axis, or return None if absent. InvalidValue if they are invalid."""
        if "seen.ages" not in arrays:
            return None
        made = cls(cells, device)
        made.ages.copy_(torch.from_numpy(validation.array(arrays, "seen.ages", np.float32, (cells**3,))))
        made.marked.copy_(torch.from_numpy(validation.array(arrays, "seen.marked", np.uint8, (cells**3,))))
        return made

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays for a checkpoint."""
        return {"seen.ages": self.ages.cpu().numpy(), "seen.marked": self.marked.cpu().numpy()}

    def resized(self, cells: int) -> "SeenCells":
        """Return a copy at another resolution, an integer multiple of this one."""
        made = SeenCells(cells, self.ages.device)
        for old, new in ((self.ages, made.ages), (self.marked, made.marked)):
            grid = old.to(torch.float32).view(1, 1, self.cells, self.cells, self.cells)
            new.copy_(F.interpolate(grid, size=(cells,) * 3, mode="nearest").reshape(-1))
        return made

    def update(self, elapsed: float, group: ProcessGroup = SINGLE_PROCESS) -> None:
        """Age cells that no process has marked since the last update by `elapsed`, a fraction of the budget."""
        marks = self.marked.to(torch.int32)  # uint8 would overflow in the sum over 256 processes
        group.add(marks)
        self.ages += elapsed
        self.ages[marks > 0] = 0
        self.marked.zero_()

    def unseen(self) -> torch.Tensor:
        """Return [cells^3] bool: cells not seen recently, nor adjacent to any that were: surfaces may still move."""
        near = (self.ages < PATIENCE).view((self.cells,) * 3)
        for axis in range(3):  # maximum over a 3^3 cube, axis by axis
            own, rest = near, self.cells - 1
            near = own.clone()
            near.narrow(axis, 1, rest).logical_or_(own.narrow(axis, 0, rest))
            near.narrow(axis, 0, rest).logical_or_(own.narrow(axis, 1, rest))
        return near.logical_not().reshape(-1)
