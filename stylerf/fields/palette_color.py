"""A global palette, mixed at every point (PaletteNeRF, Kuang et al. 2023), that can be edited without training.

The heads (section 4), with phi the features of a point and Y the spherical harmonics of a direction:

    diffuse   f = sigmoid(A phi + b)                      view-independent
    specular  s = tanh(S2 relu(S1 (phi, Y)))              view-dependent
    palette   h = F2 relu(F1 (phi, f)),  15 numbers;  O h = z [M], delta [M, 3], I
              w_i = (softplus(z_i) + 0.05) / sum

    direct color f + s,  palette color sum_i w_i softplus(I) (P_i + delta_i) + s
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from stylerf import validation
from stylerf.errors import InvalidValue
from stylerf.fields.color_heads import Packed, uncolored
from stylerf.fields.hash_grid import HashFeatures, Levels
from stylerf.fields.marching import ScratchArena
from stylerf.fields.palette_edits import Recoloring, recolored
from stylerf.geometry.spherical_harmonics import BANDS
from stylerf.kernels.cpu.ray_samples import ShadingPoints
from stylerf.kernels.cpu.regions import MIN_ODDS
from stylerf.kernels.cpu.simd_hash import ROW

if TYPE_CHECKING:  # torch takes more than a second to import, and fields without a palette are rendered without it
    from torch import Tensor

POINTS_AT_ONCE = 1 << 16
MOST_BASES = 16
MOST_EDITS = 100  # every edit is evaluated at every point
DEGREE = 2
VIEW_UNITS, UNITS, CODE = 32, 64, 15  # PaletteNeRF: 64 and 15
MIN_WEIGHT = 0.05  # before normalization
EVEN = math.log(math.e - 1)  # softplus(EVEN) = 1


@dataclass(frozen=True)
class Parts:
    """diffuse, specular: [n, 3]. weights: [n, M], rows add up to 1. offsets: [n, M, 3]. intensity: [n, 1], positive."""

    diffuse: "Tensor"
    specular: "Tensor"
    weights: "Tensor"
    offsets: "Tensor"
    intensity: "Tensor"

    def mixed(self, palette: "Tensor") -> "Tensor":
        """Return [n, 3]: sum_i w_i I (P_i + delta_i), without the specular part."""
        return self.intensity * (self.weights @ palette + (self.weights[..., None] * self.offsets).sum(1))


class PaletteHead:
    """The heads' layers. numbers: weights [outputs, inputs] and biases of A, S1, S2, F1, F2, O, in this order."""

    def __init__(self, features: int, bases: int) -> None:
        self.features, self.bases = features, bases
        self.layers = [
            (features, 3),
            (features + BANDS[DEGREE], VIEW_UNITS),
            (VIEW_UNITS, 3),
            (features + 3, UNITS),
            (UNITS, CODE),
            (CODE, 4 * bases + 1),
        ]

    @property
    def length(self) -> int:
        """Number of values."""
        return sum((inside + 1) * outside for inside, outside in self.layers)

    def initial(self, generator: np.random.Generator) -> np.ndarray:
        """Return uniform initial values (He et al. 2015): weights nearly even, offsets nearly 0, intensity nearly 1."""
        parts = []
        for number, (inside, outside) in enumerate(self.layers):
            bound = math.sqrt(6 / inside) * (0.1 if number in (2, 5) else 1.0)
            parts += [generator.uniform(-bound, bound, inside * outside), np.zeros(outside)]
        parts[-1][-1] = EVEN  # the bias of the intensity, the last output
        return np.concatenate(parts).astype(np.float32)

    def parts(self, numbers: "Tensor", phi: "Tensor", basis: "Tensor", apart: bool = False) -> Parts:
        """Return the parts at points with features phi [n, features] and spherical harmonics `basis` [n, 9].

        apart: stop gradients from the palette branch to the diffuse color that it reads.
        """
        import torch
        from torch.nn.functional import linear, softplus

        sizes = [size for inside, outside in self.layers for size in (inside * outside, outside)]
        # clone: the alignment of a slice can change the last bit of a matrix product.
        flat = iter([part.clone() for part in numbers.split(sizes)])

        def layer(number: int, values: "Tensor") -> "Tensor":
            inside, outside = self.layers[number]
            return linear(values, next(flat).view(outside, inside), next(flat))

        diffuse = torch.sigmoid(layer(0, phi))
        specular = torch.tanh(layer(2, layer(1, torch.cat([phi, basis], 1)).relu()))
        read = torch.cat([phi, diffuse.detach() if apart else diffuse], 1)
        outputs = layer(5, layer(4, layer(3, read).relu()))
        raw = softplus(outputs[:, : self.bases]) + MIN_WEIGHT
        offsets = outputs[:, self.bases : 4 * self.bases].reshape(-1, self.bases, 3)
        return Parts(diffuse, specular, raw / raw.sum(1, keepdim=True), offsets, softplus(outputs[:, -1:]))


class PaletteColor:
    """Color clamp(sum_i w_i I (P_i + delta_i) + s, 0, 1), after `edits`.

    values: the features' table, the palette [bases, 3], then the head's weights. edits: applied in order, stored by
    describe(), not learnable.
    """

    kind = "palette"
    degree = DEGREE

    def __init__(
        self, features: HashFeatures, bases: int, values: np.ndarray, edits: Sequence[Recoloring] = ()
    ) -> None:
        if not 1 <= bases <= MOST_BASES:
            raise InvalidValue(f"palette color: expected 1 to {MOST_BASES} bases, found {bases}")
        self.features, self.head = features, PaletteHead(features.width, bases)
        expected = features.length + 3 * bases + self.head.length
        if values.shape != (expected,) or values.dtype != np.float32:
            raise InvalidValue(f"palette color: expected {expected} float32 values, found {values.shape}")
        if len(edits) > MOST_EDITS:
            raise InvalidValue(
                f"palette color: {len(edits)} successive edits; at most {MOST_EDITS} are supported. Combine several "
                "changes into one edit of the field before them"
            )
        self.bases, self.values, self.edits = bases, values, tuple(edits)
        for edit in self.edits:
            edit.changes.check(bases)

    @classmethod
    def create(
        cls, generator: np.random.Generator, palette: np.ndarray, levels: int, finest: int, table: int, base: int = 16
    ) -> "PaletteColor":
        """Create a color from an initial palette [bases, 3], sRGB. table: most vertices per level, a power of two."""
        features = HashFeatures(Levels(levels, min(base, finest), finest, table, ROW, levels))
        head = PaletteHead(features.width, len(palette))
        parts = [features.initial(generator), np.asarray(palette, np.float32).ravel(), head.initial(generator)]
        return cls(features, len(palette), np.concatenate(parts))

    def edited(self, edit: Recoloring) -> "PaletteColor":
        """Return the color with one more edit, sharing `values`. Raises InvalidValue if it already has MOST_EDITS."""
        return PaletteColor(self.features, self.bases, self.values, (*self.edits, edit))

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
        """The learned palette [bases, 3], sRGB, not limited to 0..1."""
        return self.rest[: 3 * self.bases].reshape(-1, 3)

    @property
    def present_palette(self) -> np.ndarray:
        """The palette [bases, 3] after the edits' color changes."""
        palette = self.palette
        for edit in self.edits:
            palette = edit.changes.palette(palette)
        return palette

    def groups(self) -> list[tuple[int, int, float]]:
        """Return (begin, end, learning-rate factor) of slices of `values`: table, palette, head."""
        begin, end = self.features.length, self.features.length + 3 * self.bases
        return [(0, begin, 3.0), (begin, end, 0.1), (end, len(self.values), 0.5)]

    def parts(self, rest: "Tensor", phi: "Tensor", basis: "Tensor", apart: bool = False) -> "tuple[Parts, Tensor]":
        """Return (Parts, palette [bases, 3]); `rest` is palette and head as one tensor. See PaletteHead.parts."""
        palette, numbers = rest[: 3 * self.bases], rest[3 * self.bases :]
        return self.head.parts(numbers, phi, basis, apart), palette.clone().view(-1, 3)

    def _shown(self, parts: Parts, palette: "Tensor", x: np.ndarray) -> "Tensor":
        """Return the edited colors [n, 3] in 0..1."""
        if not self.edits:
            return (parts.mixed(palette) + parts.specular).clamp(0, 1)
        mixture = parts.weights, parts.offsets, parts.intensity, parts.specular
        return recolored(*mixture, palette, self.edits, x).clamp(0, 1)

    def colors(
        self, points: ShadingPoints, basis: np.ndarray, threads: int, arena: ScratchArena | None = None
    ) -> np.ndarray:
        return self.observed(points, basis, threads, lambda index, rays, mixture: None, arena)

    def observed(
        self,
        points: ShadingPoints,
        basis: np.ndarray,
        threads: int,
        seen: Callable[[np.ndarray, np.ndarray, Callable[[], np.ndarray]], None],
        arena: ScratchArena | None = None,
    ) -> np.ndarray:
        """Return the same as colors(), and pass the mixture behind each color to a callback.

        Args:
            seen: called with the indices of colored points, the ray of each, and a function that returns their
                mixtures before `edits`, [n, mixture_width]: w_i, w_i I (P_i + delta_i), s, x. remixed() takes their
                means.
        """
        import torch

        out, rest, x = uncolored(points, threads, arena), torch.from_numpy(self.rest), points.x
        packed = Packed.weighted(points, threads)
        for at in range(0, len(packed.index), POINTS_AT_ONCE):
            index, rays = packed.index[at : at + POINTS_AT_ONCE], packed.ray[at : at + POINTS_AT_ONCE]
            phi = torch.from_numpy(self.features.encode(self.table, x, index, threads))
            with torch.no_grad():
                parts, palette = self.parts(rest, phi, torch.from_numpy(basis[rays]))
                out[index] = self._shown(parts, palette, x[index]).numpy()
            seen(index, rays, partial(_mixtures, parts, palette, x[index]))
        return out

    @property
    def mixture_width(self) -> int:
        """Number of values in a mixture."""
        return 4 * self.bases + 6

    def mixes_as(self, other: object) -> bool:
        """Whether another color has the same mixtures, regardless of its edits."""
        return isinstance(other, PaletteColor) and other.values is self.values

    def remixed(self, mixtures: np.ndarray) -> np.ndarray:
        """Return the colors [n, 3] of mean mixtures [n, mixture_width] after the edits.

        Exact for a single point. For several, the mean is edited instead of each point, which shifts hues where they
        differ.
        """
        import torch

        mixed = torch.from_numpy(mixtures)
        weights, bases, specular = mixed.split([self.bases, 3 * self.bases, 6], 1)
        apart = bases.reshape(len(mixed), self.bases, 3) / weights.clamp_min(1e-6)[..., None]
        palette, one = torch.from_numpy(self.palette), torch.ones(len(mixed), 1)
        colors = recolored(weights, apart - palette, one, specular[:, :3], palette, self.edits, mixtures[:, -3:])
        return colors.clamp(0, 1).numpy()

    def backward(self, points: ShadingPoints, basis, colors, color_gradients, to: np.ndarray) -> None:
        packed, gradients, own = self._feature_gradients(points, basis, colors, color_gradients, len(to))
        self.features.backward(self.table, points.x, packed.index, gradients, to)
        to[0, self.features.length :] += own  # already summed by torch, so one buffer suffices

    def add_position_gradients(self, points: ShadingPoints, basis, colors, color_gradients, out, threads: int) -> None:
        """Add dL/dx to out [n, 3]; the edits' filters are treated as constant."""
        packed, gradients, _ = self._feature_gradients(points, basis, colors, color_gradients, threads)
        self.features.add_position_gradients(self.table, points.x, packed.index, gradients, out, threads)

    def _feature_gradients(self, points: ShadingPoints, basis, colors, color_gradients, threads: int):
        """Return (packed points, their dL/d(features), dL/d(palette and head))."""
        import torch

        packed, x = Packed.colored(points, colors, threads), points.x
        gradients = np.empty((len(packed.index), self.features.width), np.float32)
        own = np.zeros(len(self.rest), np.float32)
        for at in range(0, len(packed.index), POINTS_AT_ONCE):
            part = slice(at, at + POINTS_AT_ONCE)
            index, rays = packed.index[part], packed.ray[part]
            rest = torch.from_numpy(self.rest.copy()).requires_grad_()
            phi = torch.from_numpy(self.features.encode(self.table, x, index, threads)).requires_grad_()
            shown = self._shown(*self.parts(rest, phi, torch.from_numpy(basis[rays])), x[index])
            towards = color_gradients[index] * _through_region(shown.detach().numpy(), colors[index])
            of_phi, of_rest = torch.autograd.grad(shown, (phi, rest), torch.from_numpy(towards))
            gradients[part] = of_phi.numpy()
            own += of_rest.numpy()
        return packed, gradients, own

    def smooth(self, strength: float, to: np.ndarray) -> None:
        self.features.smooth(self.table, strength, to)

    def describe(self) -> dict:
        edits = [edit.describe() for edit in self.edits]
        return {"kind": self.kind, "features": self.features.describe(), "bases": self.bases, "edits": edits}

    @classmethod
    def restore(cls, data: dict, values: np.ndarray) -> "PaletteColor":
        edits = [Recoloring.restore(edit) for edit in validation.entry(data, "edits", list)]
        features = HashFeatures.restore(validation.entry(data, "features"))
        return cls(features, validation.integer(data, "bases", 1, MOST_BASES), values, edits)


def _through_region(own: np.ndarray, shown: np.ndarray) -> np.ndarray:
    """Return d(shown) / d(own) [n, 3], where shown is sigmoid(logit(own) + f) inside a region's color, else `own`."""
    slope = shown * (1 - shown) / np.maximum(own * (1 - own), MIN_ODDS)
    return np.where(shown == own, np.float32(1), slope)


def _mixtures(parts: Parts, palette: "Tensor", x: np.ndarray) -> np.ndarray:
    """Return [n, 4 bases + 6]; see PaletteColor.observed."""
    bases = parts.weights[..., None] * parts.intensity[..., None] * (palette + parts.offsets)
    return np.concatenate([parts.weights.numpy(), bases.flatten(1).numpy(), parts.specular.numpy(), x], 1)
