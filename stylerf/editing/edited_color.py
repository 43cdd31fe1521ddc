"""The color of a field with a local edit that has not been trained into it yet."""

from collections.abc import Callable

import numpy as np
import torch

from stylerf.editing.edit_grid import cells_of_points
from stylerf.editing.palette_module import DEGREE, PaletteModule
from stylerf.fields.color_heads import Packed
from stylerf.fields.marching import ScratchArena
from stylerf.fields.palette_edits import PaletteEdits
from stylerf.fields.protocol import ColorPart
from stylerf.kernels.cpu.ray_samples import ShadingPoints


class EditedColor:
    """The colors of another part, replaced in marked cells with those of a palette module after changes.

    The module was trained at ray ends; here it is evaluated at samples, which are near them. For previews only: it
    cannot be trained or stored.

    Args:
        base: the field's color part.
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
        """Return colors [n, 3] in 0..1 of samples; -1 in the first channel of uncolored samples."""
        return self.observed(points, basis, threads, lambda index, rays, mixture: None, arena)

    def observed(
        self,
        points: ShadingPoints,
        basis: np.ndarray,
        threads: int,
        seen: Callable[[np.ndarray, np.ndarray, Callable[[], np.ndarray]], None],
        arena: ScratchArena | None = None,
    ) -> np.ndarray:
        """Return the same as colors(), and pass the mixtures behind the region's colors to a callback.

        Args:
            seen: called with the indices of points in marked cells, the ray of each, and a function that returns their
                mixtures before the changes, [n, mixture_width]: weights and offset. remixed() takes their means.
        """
        bands = (getattr(self._base, "degree", 0) + 1) ** 2
        out = self._base.colors(points, np.ascontiguousarray(basis[:, :bands]), threads, arena)
        packed = Packed.colored(points, out, threads)
        inside = self._marked[tuple(cells_of_points(points.x[packed.index], self._marked.shape[0]).T)]
        index = packed.index[inside]
        if len(index):
            found = self._module.mixture_of(points.x[index], basis[packed.ray[inside]], threads)
            out[index] = self._module.edited(found, self._changes)
            seen(index, packed.ray[inside], lambda: np.concatenate([found.weights.numpy(), found.offsets.numpy()], 1))
        return out

    @property
    def mixture_width(self) -> int:
        """Number of values in a mixture."""
        return len(self._module.palette) + 3

    def mixes_as(self, other: object) -> bool:
        """Whether another color has the same mixtures at the same points, regardless of the changes."""
        return (
            isinstance(other, EditedColor)
            and other._base is self._base
            and other._module is self._module
            and other._marked is self._marked
        )

    def remixed(self, mixtures: np.ndarray) -> np.ndarray:
        """Return the colors [n, 3] of mean mixtures [n, mixture_width] after the changes; exact for equal points."""
        weights, offsets = torch.from_numpy(mixtures).tensor_split([mixtures.shape[1] - 3], 1)
        return self._module.edited(self._module.mixed(weights, offsets), self._changes)
