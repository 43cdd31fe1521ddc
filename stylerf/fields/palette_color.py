"""A palette for the whole scene, mixed at every point (PaletteNeRF, Kuang et al. 2023), that can be edited at once."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from stylerf import validation
from stylerf.errors import InvalidValue
from stylerf.fields.color_heads import Packed, uncolored
from stylerf.fields.encoders import HashFeatures
from stylerf.fields.hash_levels import Levels
from stylerf.fields.palette_head import DEGREE, PaletteHead, Parts
from stylerf.fields.recoloring import Recoloring, recolored
from stylerf.fields.scratch_arena import ScratchArena
from stylerf.kernels.cpu.ray_samples import ShadingPoints
from stylerf.kernels.cpu.simd_hash import ROW

POINTS_AT_ONCE = 1 << 16
MOST_BASES = 16


class PaletteColor:
    """Color clamp(sum_i w_i I (P_i + delta_i) + s, 0, 1) of fields/palette_head.py, after `edits`.

    values: the features' table, the palette [bases, 3], the head's numbers. edits: in their order; part of describe();
    they do not learn.
    """

    kind = "palette"
    degree = DEGREE

    def __init__(
        self, features: HashFeatures, bases: int, values: np.ndarray, edits: Sequence[Recoloring] = ()
    ) -> None:
        if not 1 <= bases <= MOST_BASES:
            raise InvalidValue(f"palette color: 1 to {MOST_BASES} bases were expected, not {bases}")
        self.features, self.head = features, PaletteHead(features.width, bases)
        expected = features.length + 3 * bases + self.head.length
        if values.shape != (expected,) or values.dtype != np.float32:
            raise InvalidValue(f"palette color: {values.shape} values where {expected} float32 ones were expected")
        self.bases, self.values, self.edits = bases, values, tuple(edits)
        for edit in self.edits:
            edit.changes.check(bases)

    @classmethod
    def create(
        cls, generator: np.random.Generator, palette: np.ndarray, levels: int, finest: int, table: int, base: int = 16
    ) -> "PaletteColor":
        """Create a color from an initial palette [bases, 3], sRGB. table: most vertices of a level, a power of two."""
        features = HashFeatures(Levels(levels, min(base, finest), finest, table, ROW, levels))
        head = PaletteHead(features.width, len(palette))
        parts = [features.initial(generator), np.asarray(palette, np.float32).ravel(), head.initial(generator)]
        return cls(features, len(palette), np.concatenate(parts))

    def edited(self, edit: Recoloring) -> "PaletteColor":
        """Return the color with one more edit; `values` are shared."""
        return PaletteColor(self.features, self.bases, self.values, (*self.edits, edit))

    # -- its values -------------------------------------------------------------------------------------------------

    @property
    def finest(self) -> int:
        """Cells per side of the finest level."""
        return self.features.levels.finest

    @property
    def table(self) -> np.ndarray:
        return self.values[: self.features.length]

    @property
    def rest(self) -> np.ndarray:
        """Palette and head, [3 bases + head]."""
        return self.values[self.features.length :]

    @property
    def palette(self) -> np.ndarray:
        """[bases, 3] as learned, sRGB; not limited to 0..1."""
        return self.rest[: 3 * self.bases].reshape(-1, 3)

    @property
    def present_palette(self) -> np.ndarray:
        """[bases, 3] after the edits' color changes."""
        palette = self.palette
        for edit in self.edits:
            palette = edit.changes.palette(palette)
        return palette

    def groups(self) -> list[tuple[int, int, float]]:
        """Return (begin, end, learning-rate factor) of slices of `values`: table, palette, head."""
        begin, end = self.features.length, self.features.length + 3 * self.bases
        return [(0, begin, 3.0), (begin, end, 0.1), (end, len(self.values), 0.5)]

    # -- colors ----------------------------------------------------------------------------------------------------

    def parts(self, rest: Tensor, phi: Tensor, basis: Tensor, apart: bool = False) -> tuple[Parts, Tensor]:
        """(Parts, palette [bases, 3]) from palette and head as one tensor; see PaletteHead.parts."""
        palette, numbers = rest[: 3 * self.bases], rest[3 * self.bases :]
        return self.head.parts(numbers, phi, basis, apart), palette.clone().view(-1, 3)

    def _shown(self, rest: Tensor, phi: Tensor, basis: Tensor, x: np.ndarray) -> Tensor:
        """[n, 3] in 0..1."""
        parts, palette = self.parts(rest, phi, basis)
        if not self.edits:
            return (parts.mixed(palette) + parts.specular).clamp(0, 1)
        given = parts.weights, parts.offsets, parts.intensity, parts.specular
        return recolored(*given, palette, self.edits, x).clamp(0, 1)

    @torch.no_grad()
    def colors(
        self, points: ShadingPoints, basis: np.ndarray, threads: int, arena: ScratchArena | None = None
    ) -> np.ndarray:
        """See ColorPart.colors."""
        out, rest, x = uncolored(points, threads, arena), torch.from_numpy(self.rest), points.x
        packed = Packed.weighted(points, threads)
        for at in range(0, len(packed.index), POINTS_AT_ONCE):
            index, rays = packed.index[at : at + POINTS_AT_ONCE], packed.ray[at : at + POINTS_AT_ONCE]
            phi = torch.from_numpy(self.features.encode(self.table, x, index, threads))
            out[index] = self._shown(rest, phi, torch.from_numpy(basis[rays]), x[index]).numpy()
        return out

    def backward(self, points: ShadingPoints, basis, colors, color_gradients, to: np.ndarray) -> None:
        """Add dL/d(values) to the threads' buffers `to` [threads, len(values)]."""
        packed, gradients, own = self._feature_gradients(points, basis, colors, color_gradients, len(to))
        self.features.backward(self.table, points.x, packed.index, gradients, to)
        to[0, self.features.length :] += own

    def add_position_gradients(self, points: ShadingPoints, basis, colors, color_gradients, out, threads: int) -> None:
        """Add dL/dx to out [n, 3]; the slope of the edits' filters is left out."""
        packed, gradients, _ = self._feature_gradients(points, basis, colors, color_gradients, threads)
        self.features.add_position_gradients(self.table, points.x, packed.index, gradients, out, threads)

    def _feature_gradients(self, points: ShadingPoints, basis, colors, color_gradients, threads: int):
        """Return (packed points, dL/d(features) of theirs, dL/d(palette and head))."""
        packed, x = Packed.colored(points, colors, threads), points.x
        gradients = np.empty((len(packed.index), self.features.width), np.float32)
        own = np.zeros(len(self.rest), np.float32)
        for at in range(0, len(packed.index), POINTS_AT_ONCE):
            part = slice(at, at + POINTS_AT_ONCE)
            index, rays = packed.index[part], packed.ray[part]
            rest = torch.from_numpy(self.rest.copy()).requires_grad_()
            phi = torch.from_numpy(self.features.encode(self.table, x, index, threads)).requires_grad_()
            shown = self._shown(rest, phi, torch.from_numpy(basis[rays]), x[index])
            shown.backward(torch.from_numpy(color_gradients[index]))
            gradients[part] = phi.grad.numpy()
            own += rest.grad.numpy()
        return packed, gradients, own

    def smooth(self, strength: float, to: np.ndarray) -> None:
        """Add the gradient of the features' total variation to buffer `to` [len(values)]."""
        self.features.smooth(self.table, strength, to)

    # -- what is kept -----------------------------------------------------------------------------------------------

    def describe(self) -> dict:
        edits = [edit.describe() for edit in self.edits]
        return {"kind": self.kind, "features": self.features.describe(), "bases": self.bases, "edits": edits}

    @classmethod
    def restore(cls, data: dict, values: np.ndarray) -> "PaletteColor":
        edits = [Recoloring.restore(edit) for edit in validation.entry(data, "edits", list)]
        features = HashFeatures.restore(validation.entry(data, "features"))
        return cls(features, validation.integer(data, "bases", 1, MOST_BASES), values, edits)
