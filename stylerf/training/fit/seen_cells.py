"""Cells of the occupancy grid that training rays see something in, and those that they have not for long.

Density that no training ray gives weight to explains no photo: it is inside or behind surfaces, or was left in front of
them when they formed. Marching through it takes time, and new views see it as haze.
"""

from typing import Self

import numpy as np
import torch
import torch.nn.functional as F

from stylerf import validation
from stylerf.training.common.process_group import SINGLE_PROCESS, ProcessGroup

PATIENCE = 0.15  # of the budget; a cell that is not seen for so long is empty


class SeenCells:
    """For how long no training ray has seen something in each cell.

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
        """From arrays() of `cells` per axis; None if there were none. Raises InvalidValue for wrong arrays."""
        if "seen.ages" not in arrays:
            return None
        made = cls(cells, device)
        made.ages.copy_(torch.from_numpy(validation.array(arrays, "seen.ages", np.float32, (cells**3,))))
        made.marked.copy_(torch.from_numpy(validation.array(arrays, "seen.marked", np.uint8, (cells**3,))))
        return made

    def arrays(self) -> dict[str, np.ndarray]:
        """The arrays of a checkpoint."""
        return {"seen.ages": self.ages.cpu().numpy(), "seen.marked": self.marked.cpu().numpy()}

    def resized(self, cells: int) -> "SeenCells":
        """The same at another resolution, a whole multiple of this one."""
        made = SeenCells(cells, self.ages.device)
        for old, new in ((self.ages, made.ages), (self.marked, made.marked)):
            grid = old.to(torch.float32).view(1, 1, self.cells, self.cells, self.cells)
            new.copy_(F.interpolate(grid, size=(cells,) * 3, mode="nearest").reshape(-1))
        return made

    def update(self, elapsed: float, group: ProcessGroup = SINGLE_PROCESS) -> None:
        """Let `elapsed`, a fraction of the budget, pass for cells that no process has marked since the last update."""
        marks = self.marked.to(torch.int32)  # uint8 would overflow in the sum over 256 processes
        group.add(marks)
        self.ages += elapsed
        self.ages[marks > 0] = 0
        self.marked.zero_()

    def unseen(self) -> torch.Tensor:
        """Cells [cells^3] bool that were not seen lately and touch none that was: surfaces may still move a little."""
        near = (self.ages < PATIENCE).view((self.cells,) * 3)
        for axis in range(3):  # a cube's maximum, axis by axis
            own, rest = near, self.cells - 1
            near = own.clone()
            near.narrow(axis, 1, rest).logical_or_(own.narrow(axis, 0, rest))
            near.narrow(axis, 0, rest).logical_or_(own.narrow(axis, 1, rest))
        return near.logical_not().reshape(-1)
