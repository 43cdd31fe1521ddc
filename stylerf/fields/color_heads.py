"""Color heads map features of a position and a view direction to a color. They hold no state: weights are arguments."""

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.fields.marching import ScratchArena, empty_array
from stylerf.geometry.spherical_harmonics import BANDS, C0
from stylerf.kernels.cpu import color_heads as kernels
from stylerf.kernels.cpu.color_heads import count_marked, hide, pack_marked
from stylerf.kernels.cpu.ray_samples import ShadingPoints

HIDDEN = 32  # units; one row is one SIMD vector


class Packed:
    """Samples to color: index[i] on ray ray[i], ascending; their colors are written to `out` [n, 3]."""

    def __init__(self, marks: np.ndarray, bound: float, starts: np.ndarray, ends: np.ndarray, threads: int) -> None:
        counts, bound32 = np.empty(len(ends), np.int64), np.float32(bound)
        count_marked(marks, bound32, starts, ends, threads, counts)
        offsets = np.concatenate([[0], np.cumsum(counts)])
        self.index, self.ray = np.empty(offsets[-1], np.int64), np.empty(offsets[-1], np.int64)
        pack_marked(marks, bound32, starts, ends, offsets, threads, self.index, self.ray)

    @classmethod
    def weighted(cls, points: ShadingPoints, threads: int) -> "Packed":
        """Pack the points with positive weight."""
        return cls(points.weights.reshape(-1, 1), 0.0, points.starts, points.ends, threads)

    @classmethod
    def colored(cls, points: ShadingPoints, colors: np.ndarray, threads: int) -> "Packed":
        """Pack the points that have a color [n, 3]: not -1 in the first channel."""
        # -0.5 is between the marker for no color, -1, and black.
        return cls(colors, -0.5, points.starts, points.ends, threads)


class _Head:
    """colors() writes the colors of packed samples with features phi [m, features] to out [n, 3].

    backward() returns dL/d(phi) [m, features] and adds dL/d(numbers) to the per-thread buffers to[:, at:]. `numbers`
    are the weights; `length` is their count, and initial() draws them.
    """

    kind: str
    rate = 1.0  # learning-rate factor

    def __init__(self, features: int, degree: int) -> None:
        self.features, self.degree = features, degree

    def describe(self) -> dict:
        return {"kind": self.kind, "degree": self.degree}


class LinearHead(_Head):
    """sigmoid(bias + sum_b Y_b(d) head_b . phi): a linear map from features to spherical-harmonic coefficients.

    numbers: head [3, bands, features], bias [3].
    """

    kind = "linear"

    @property
    def length(self) -> int:
        return 3 * BANDS[self.degree] * self.features + 3

    def initial(self, generator: np.random.Generator) -> np.ndarray:
        """Return random values: about mid-gray, with weak view dependence."""
        # Divided by C0, the constant harmonic that the head is multiplied by.
        head = generator.uniform(-1, 1, (3, BANDS[self.degree], self.features)) / np.sqrt(self.features) / C0
        head[:, 1:] *= 0.1
        return np.append(head.ravel(), np.zeros(3)).astype(np.float32)

    def colors(self, phi, numbers, basis, packed: Packed, threads: int, out: np.ndarray) -> None:
        widths = (np.int8(0),) * self.features
        kernels.linear(phi, widths, numbers, basis, packed.index, packed.ray, threads, out)

    def backward(self, phi, numbers, basis, packed, colors, color_gradients, at: int, to: np.ndarray) -> np.ndarray:
        widths, out, where = (np.int8(0),) * self.features, np.empty_like(phi), (basis, packed.index, packed.ray)
        kernels.linear_backward(phi, widths, numbers, *where, colors, color_gradients, len(to), out, at, to)
        return out


class HarmonicHead(_Head):
    """sigmoid(sum_b Y_b(d) phi_b): the features are spherical-harmonic coefficients [3, bands], as in ARF's voxels."""

    kind = "harmonic"
    length = 0

    def __init__(self, features: int, degree: int) -> None:
        if features != 3 * BANDS[degree]:
            raise InvalidValue(f"{features} features are not coefficients of degree {degree}")
        super().__init__(features, degree)

    def initial(self, generator: np.random.Generator) -> np.ndarray:
        return np.empty(0, np.float32)

    def colors(self, phi, numbers, basis, packed: Packed, threads: int, out: np.ndarray) -> None:
        kernels.harmonic(phi, basis, packed.index, packed.ray, threads, out)

    def backward(self, phi, numbers, basis, packed, colors, color_gradients, at: int, to: np.ndarray) -> np.ndarray:
        out = np.empty_like(phi)
        kernels.harmonic_backward(basis, packed.index, packed.ray, colors, color_gradients, len(to), out)
        return out


class MlpHead(_Head):
    """sigmoid(W2 relu(W1 (phi, Y(d)) + b1) + b2), HIDDEN units; see kernels/cpu/color_heads.py for `numbers`."""

    kind = "mlp"
    rate = 0.25
    _hidden = (np.int8(0),) * HIDDEN

    @property
    def length(self) -> int:
        return (self.features + BANDS[self.degree] + 1 + 3) * HIDDEN + 3

    def initial(self, generator: np.random.Generator) -> np.ndarray:
        """Return uniform initial values (He et al. 2015), small for the direction's weights."""
        first = generator.uniform(-1, 1, (self.features, HIDDEN)) * np.sqrt(6 / self.features)
        seen = generator.uniform(-0.1, 0.1, (BANDS[self.degree], HIDDEN))
        second = generator.uniform(-1, 1, (3, HIDDEN)) * np.sqrt(6 / HIDDEN)
        parts = [first, seen, np.zeros(HIDDEN), second, np.zeros(3)]
        return np.concatenate([part.ravel() for part in parts]).astype(np.float32)

    def colors(self, phi, numbers, basis, packed: Packed, threads: int, out: np.ndarray) -> None:
        kernels.mlp(phi, self._hidden, numbers, basis, packed.index, packed.ray, threads, out)

    def backward(self, phi, numbers, basis, packed, colors, color_gradients, at: int, to: np.ndarray) -> np.ndarray:
        out, where = np.empty_like(phi), (basis, packed.index, packed.ray)
        kernels.mlp_backward(phi, self._hidden, numbers, *where, colors, color_gradients, len(to), out, at, to)
        return out


Head = LinearHead | HarmonicHead | MlpHead
HEADS: dict[str, type[LinearHead] | type[HarmonicHead] | type[MlpHead]] = {
    "linear": LinearHead,
    "harmonic": HarmonicHead,
    "mlp": MlpHead,
}


def uncolored(points: ShadingPoints, threads: int, arena: ScratchArena | None) -> np.ndarray:
    """Return a color array [n, 3] in which no point has a color yet."""
    out = empty_array((len(points.x), 3), arena)
    hide(points.starts, points.ends, threads, out)
    return out
