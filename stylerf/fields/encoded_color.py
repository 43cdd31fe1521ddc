"""Color as a position encoding of any kind followed by any color head (color_heads.py)."""

import numpy as np

from stylerf import validation
from stylerf.errors import InvalidValue
from stylerf.fields.color_heads import HEADS, Head, Packed, uncolored
from stylerf.fields.hash_grid import HashFeatures
from stylerf.fields.marching import ScratchArena
from stylerf.fields.protocol import Capacity
from stylerf.fields.vm import VmFeatures
from stylerf.fields.voxel import VoxelFeatures
from stylerf.geometry.spherical_harmonics import BANDS
from stylerf.kernels.cpu.ray_samples import ShadingPoints

Features = VmFeatures | HashFeatures | VoxelFeatures
FEATURES: dict[str, type[VmFeatures] | type[HashFeatures] | type[VoxelFeatures]] = {
    "vm": VmFeatures,
    "hash": HashFeatures,
    "voxel": VoxelFeatures,
}


class EncodedColor:
    """Color head(features(x), d). values: the features' table, then the head's weights.

    Features of all colored samples go through memory between the two, 4 bytes times their width per sample. That costs
    at most a twentieth of a step, and lets any encoder work with any head.
    """

    kind = "headed"

    def __init__(self, features: Features, head: Head, values: np.ndarray) -> None:
        if len(values) != features.length + head.length:
            raise InvalidValue(
                f"{features.kind} color: expected {features.length + head.length} values, found {len(values)}"
            )
        self.features, self.head, self.values = features, head, values

    @classmethod
    def create(
        cls, kind: str, head: str, capacity: Capacity, degree: int, generator: np.random.Generator
    ) -> "EncodedColor":
        """Create a color; head: linear or mlp. Voxels already hold coefficients, which `linear` uses directly."""
        features = FEATURES[kind].of(capacity, degree)
        made = HEADS["harmonic" if (kind, head) == ("voxel", "linear") else head](features.width, degree)
        return cls(features, made, np.concatenate([features.initial(generator), made.initial(generator)]))

    @property
    def degree(self) -> int:
        """Degree of the spherical harmonics that the head reads."""
        return self.head.degree

    @property
    def table(self) -> np.ndarray:
        return self.values[: self.features.length]

    @property
    def numbers(self) -> np.ndarray:
        """The head's weights."""
        return self.values[self.features.length :]

    def groups(self) -> list[tuple[int, int, float]]:
        features, end = self.features, len(self.values)
        return [(features.fixed, features.length, features.rate), (features.length, end, self.head.rate)]

    def grown(self, capacity: Capacity, generator: np.random.Generator) -> "EncodedColor":
        """Return the same color with a larger capacity."""
        features, table = self.features.grown(self.table, capacity)
        return EncodedColor(features, self.head, np.concatenate([table, self.numbers]))

    def colors(
        self, points: ShadingPoints, basis: np.ndarray, threads: int, arena: ScratchArena | None = None
    ) -> np.ndarray:
        out = uncolored(points, threads, arena)
        packed = Packed.weighted(points, threads)
        phi = self.features.encode(self.table, points.x, packed.index, threads)
        self.head.colors(phi, self.numbers, basis, packed, threads, out)
        return out

    def backward(self, points: ShadingPoints, basis, colors, color_gradients, to: np.ndarray) -> None:
        at = self.features.length
        packed, gradients = self._feature_gradients(points, basis, colors, color_gradients, at, to)
        self.features.backward(self.table, points.x, packed.index, gradients, to)

    def add_position_gradients(self, points: ShadingPoints, basis, colors, color_gradients, out, threads: int) -> None:
        # The head's backward also accumulates the gradients of its weights, which are not needed here.
        unused = np.zeros((threads, self.head.length), np.float32)
        packed, gradients = self._feature_gradients(points, basis, colors, color_gradients, 0, unused)
        self.features.add_position_gradients(self.table, points.x, packed.index, gradients, out, threads)

    def _feature_gradients(self, points: ShadingPoints, basis, colors, color_gradients, at: int, to: np.ndarray):
        """Return (packed points, their dL/d(features)); adds dL/d(head's weights) to to[:, at:]."""
        packed = Packed.colored(points, colors, len(to))
        phi = self.features.encode(self.table, points.x, packed.index, len(to))
        return packed, self.head.backward(phi, self.numbers, basis, packed, colors, color_gradients, at, to)

    def smooth(self, strength: float, to: np.ndarray) -> None:
        self.features.smooth(self.table, strength, to)

    def describe(self) -> dict:
        return {"kind": self.kind, "features": self.features.describe(), "head": self.head.describe()}

    @classmethod
    def restore(cls, data: dict, values: np.ndarray) -> "EncodedColor":
        described, head = validation.entry(data, "features"), validation.entry(data, "head")
        features = FEATURES[validation.one_of(described, "kind", FEATURES)].restore(described)
        degree = validation.integer(head, "degree", 0, max(BANDS))
        return cls(features, HEADS[validation.one_of(head, "kind", HEADS)](features.width, degree), values)
