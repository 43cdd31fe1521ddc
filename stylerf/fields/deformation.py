"""A deformation of space x' = x + D(x) as a small network over encoded positions (DeSRF, section 3.2)."""

import math

import numpy as np
import torch
from torch import Tensor

from stylerf import validation
from stylerf.errors import InvalidValue

# Adam moves every weight by about its rate, and a sum over 256 of them by up to 256 times that: without this factor a
# rate of 1e-3 would move a scene by a twentieth of its size in every step.
SCALE = 0.05
# Largest displacement per axis, cube units. Without a bound, any rate that bends an object eventually tears it: nothing
# in a style loss holds its parts together (decision 0015).
FARTHEST = 0.04


class Deformation:
    """D = MLP(gamma(p)), p = 2 x - 1 of cube positions x in 0..1; values: weights and biases, layer after layer.

    gamma(p) = (p, sin 2^l pi p, cos 2^l pi p for l < frequencies); three linear layers with ReLU between. D is in cube
    units: half of SCALE times the network's output, since the cube is two units of p wide, through a hyperbolic tangent
    that bounds every coordinate by FARTHEST.
    """

    def __init__(self, frequencies: int, width: int, values: np.ndarray) -> None:
        self.frequencies, self.width, self.values = int(frequencies), int(width), values
        if len(values) != sum((inside + 1) * outside for inside, outside in self._layers()):
            raise InvalidValue(f"deformation: {len(values)} values do not make a network of width {width}")

    @classmethod
    def create(cls, generator: np.random.Generator, frequencies: int = 5, width: int = 256) -> "Deformation":
        """Create the identity: the last layer is zero."""
        parts = []
        for inside, outside in _layers(frequencies, width)[:-1]:
            bound = math.sqrt(6.0 / inside)  # He et al. 2015, for ReLU
            parts += [generator.uniform(-bound, bound, inside * outside), np.zeros(outside)]
        parts.append(np.zeros((width + 1) * 3))
        return cls(frequencies, width, np.concatenate(parts).astype(np.float32))

    def _layers(self) -> list[tuple[int, int]]:
        return _layers(self.frequencies, self.width)

    def encode(self, positions: Tensor) -> Tensor:
        """Return gamma(p), [n, 3 + 6 frequencies], of cube positions [n, 3]."""
        p = 2 * positions - 1
        scaled = p[:, None] * (math.pi * 2.0 ** torch.arange(self.frequencies, dtype=p.dtype))[:, None]
        return torch.cat([p, torch.cat([scaled.sin(), scaled.cos()], -1).flatten(1)], 1)

    def network(self, encoded: Tensor, values: Tensor) -> Tensor:
        """Return D [n, 3], cube units, of encoded positions [n, 3 + 6 frequencies], with the weights `values`."""
        out, at = encoded, 0
        layers = self._layers()
        for number, (inside, outside) in enumerate(layers):
            weight = values[at : at + inside * outside].view(outside, inside)
            bias = values[at + inside * outside : at + (inside + 1) * outside]
            out = torch.nn.functional.linear(out, weight, bias)
            out = out.relu() if number + 1 < len(layers) else out
            at += (inside + 1) * outside
        return FARTHEST * torch.tanh((0.5 * SCALE / FARTHEST) * out)

    def describe(self) -> dict:
        return {"kind": "mlp", "frequencies": self.frequencies, "width": self.width}

    @classmethod
    def restore(cls, data: dict, values: np.ndarray) -> "Deformation":
        frequencies, width = validation.integer(data, "frequencies", 0, 16), validation.integer(data, "width", 1, 1024)
        validation.one_of(data, "kind", ("mlp",))
        return cls(frequencies, width, values)


def _layers(frequencies: int, width: int) -> list[tuple[int, int]]:
    return [(3 + 6 * frequencies, width), (width, width), (width, 3)]
