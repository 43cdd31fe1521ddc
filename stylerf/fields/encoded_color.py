"""A color as an encoder of places (encoders.py) and a head behind it (color_heads.py), any with any."""

import numpy as np

from stylerf import validation
from stylerf.errors import InvalidValue
from stylerf.fields.capacity import Capacity
from stylerf.fields.color_heads import HEADS, Packed, hidden_from_view
from stylerf.fields.encoders import FEATURES
from stylerf.fields.ray_samples import Samples
from stylerf.geometry.spherical_harmonics import BANDS


class EncodedColor:
    """Color head(features(x), d). values: the features' table, the head's numbers.

    Features of all colored samples are written out between the two: 4 bytes times their width a sample (at most a
    twentieth of a step), for which any encoder goes with any head.
    """

    kind = "headed"

    def __init__(self, features, head, values: np.ndarray) -> None:
        if len(values) != features.length + head.length:
            raise InvalidValue(
                f"{features.kind} color: {len(values)} values where {features.length + head.length} were expected"
            )
        self.features, self.head, self.values = features, head, values

    @classmethod
    def create(
        cls, kind: str, head: str, capacity: Capacity, degree: int, generator: np.random.Generator
    ) -> "EncodedColor":
        """head: linear or mlp. What a voxel holds are coefficients already: `linear` leaves them as they are."""
        features = FEATURES[kind].of(capacity, degree)
        made = HEADS["harmonic" if (kind, head) == ("voxel", "linear") else head](features.width, degree)
        return cls(features, made, np.concatenate([features.initial(generator), made.initial(generator)]))

    @property
    def degree(self) -> int:
        """Of the spherical harmonics that are asked for."""
        return self.head.degree

    @property
    def table(self) -> np.ndarray:
        return self.values[: self.features.length]

    @property
    def numbers(self) -> np.ndarray:
        """The head's."""
        return self.values[self.features.length :]

    def groups(self) -> list[tuple[int, int, float]]:
        """(begin, end, learning-rate factor) of parts of `values`."""
        features, end = self.features, len(self.values)
        return [(features.fixed, features.length, features.rate), (features.length, end, self.head.rate)]

    def grown(self, capacity: Capacity, generator: np.random.Generator) -> "EncodedColor":
        """The same color at a larger capacity."""
        features, table = self.features.grown(self.table, capacity, generator)
        return EncodedColor(features, self.head, np.concatenate([table, self.numbers]))

    def colors(self, x, basis, starts, ends, weights, least, chunks) -> np.ndarray:
        """[n, 3] colors in 0..1 of samples with weight > least; others have -1 in the first channel."""
        out = hidden_from_view(starts, ends, len(x), chunks)
        packed = Packed(weights.reshape(-1, 1), least, starts, ends, chunks)
        phi = self.features.encode(self.table, x, packed.index, chunks)
        self.head.colors(phi, self.numbers, basis, packed, chunks, out)
        return out

    def backward(self, x, basis, starts, ends, colors, color_gradients, to: np.ndarray) -> None:
        """Add dL/d(values) to the chunks' buffers `to` [chunks, len(values)]."""
        at = self.features.length
        packed, gradients = self._feature_gradients(x, basis, starts, ends, colors, color_gradients, at, to)
        self.features.backward(self.table, x, packed.index, gradients, to)

    def add_position_gradients(
        self, samples: Samples, basis: np.ndarray, colors: np.ndarray, color_gradients: np.ndarray, out, chunks: int
    ) -> None:
        """Add dL/dx to out [n, 3], x the samples' positions in the cube."""
        scratch = np.zeros((chunks, self.head.length), np.float32)
        where = samples.x, basis, samples.starts, samples.ends
        packed, gradients = self._feature_gradients(*where, colors, color_gradients, 0, scratch)
        self.features.add_position_gradients(self.table, samples.x, packed.index, gradients, out, chunks)

    def _feature_gradients(self, x, basis, starts, ends, colors, color_gradients, at, to):
        chunks = len(to)
        packed = Packed(colors, -0.5, starts, ends, chunks)
        phi = self.features.encode(self.table, x, packed.index, chunks)
        return packed, self.head.backward(phi, self.numbers, basis, packed, colors, color_gradients, at, to)

    def smooth(self, strength: float, to: np.ndarray) -> None:
        """Add the gradient of the features' total variation to buffer `to` [len(values)]."""
        self.features.smooth(self.table, strength, to)

    def describe(self) -> dict:
        return {"kind": self.kind, "features": self.features.describe(), "head": self.head.describe()}

    @classmethod
    def restore(cls, data: dict, values: np.ndarray) -> "EncodedColor":
        described, head = validation.entry(data, "features"), validation.entry(data, "head")
        features = FEATURES[validation.one_of(described, "kind", FEATURES)].restore(described)
        degree = validation.integer(head, "degree", 0, max(BANDS))
        return cls(features, HEADS[validation.one_of(head, "kind", HEADS)](features.width, degree), values)
