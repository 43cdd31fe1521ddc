"""The color of a field under a local edit that is not trained into it yet."""

import numpy as np

from stylerf.editing.edit_grid import cells_of_points
from stylerf.editing.palette_module import DEGREE, PaletteModule
from stylerf.fields.color_heads import Packed
from stylerf.fields.marching import ScratchArena
from stylerf.fields.palette_edits import PaletteEdits
from stylerf.fields.protocol import ColorPart
from stylerf.kernels.cpu.ray_samples import ShadingPoints


class EditedColor:
    """Colors of another part, and in marked cells those of a palette module after changes.

    The module has learned from the ends of rays; here it is asked at their samples, which lie around those. To look
    at only: it learns nothing and is not stored.

    Args:
        base: the field's colors.
        module: of the edit.
        marked: [s, s, s] bool.
        changes: of the module's palette.
    """

    kind = "edited"
    degree = DEGREE

    def __init__(self, base: ColorPart, module: PaletteModule, marked: np.ndarray, changes: PaletteEdits) -> None:
        self._base, self._module, self._marked, self._changes = base, module, marked, changes

    def colors(
        self, points: ShadingPoints, basis: np.ndarray, threads: int, arena: ScratchArena | None = None
    ) -> np.ndarray:
        """Return colors [n, 3] in 0..1 of samples; -1 in the first channel where one has none."""
        bands = (getattr(self._base, "degree", 0) + 1) ** 2
        out = self._base.colors(points, np.ascontiguousarray(basis[:, :bands]), threads, arena)
        packed = Packed.colored(points, out, threads)
        inside = self._marked[tuple(cells_of_points(points.x[packed.index], self._marked.shape[0]).T)]
        index = packed.index[inside]
        if len(index):
            found = self._module.mixture_of(points.x[index], basis[packed.ray[inside]], threads)
            out[index] = self._module.edited(found, self._changes)
        return out
