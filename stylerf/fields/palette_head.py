"""The heads of a palette decomposition: mixing weights, offsets, intensity, and a direct color.

PaletteNeRF (Kuang et al. 2023, section 4). With phi the features of a place and Y the harmonics of a direction:

    diffuse   f = sigmoid(A phi + b)                      independent of the view
    specular  s = tanh(S2 relu(S1 (phi, Y)))              dependent on the view
    palette   h = F2 relu(F1 (phi, f)),  15 numbers;  O h = z [M], delta [M, 3], I
              w_i = (softplus(z_i) + 0.05) / sum

    direct color f + s,  palette color sum_i w_i softplus(I) (P_i + delta_i) + s
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import linear, softplus

from stylerf.geometry.spherical_harmonics import BANDS

DEGREE = 2
VIEW_UNITS, UNITS, CODE = 32, 64, 15  # PaletteNeRF: 64 and 15
MIN_WEIGHT = 0.05  # before normalization
EVEN = math.log(math.e - 1)  # its softplus is 1


@dataclass(frozen=True)
class Parts:
    """diffuse, specular [n, 3]; weights [n, M], each row adds up to 1; offsets [n, M, 3]; intensity [n, 1] > 0."""

    diffuse: Tensor
    specular: Tensor
    weights: Tensor
    offsets: Tensor
    intensity: Tensor

    def mixed(self, palette: Tensor) -> Tensor:
        """Return [n, 3]: sum_i w_i I (P_i + delta_i), without the specular part."""
        return self.intensity * (self.weights @ palette + (self.weights[..., None] * self.offsets).sum(1))


class PaletteHead:
    """numbers: weights [outputs, inputs] and biases of each layer, A, S1, S2, F1, F2, O."""

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
        parts[-1][-1] = EVEN
        return np.concatenate(parts).astype(np.float32)

    def parts(self, numbers: Tensor, phi: Tensor, basis: Tensor, apart: bool = False) -> Parts:
        """Return the parts at points with features phi [n, features], seen from directions with harmonics [n, 9].

        apart: no gradient flows from the palette branch to the diffuse color that it reads.
        """
        sizes = [size for inside, outside in self.layers for size in (inside * outside, outside)]
        # clone: the alignment of a slice can change the last bit of a matrix product.
        flat = iter([part.clone() for part in numbers.split(sizes)])

        def layer(number: int, values: Tensor) -> Tensor:
            inside, outside = self.layers[number]
            return linear(values, next(flat).view(outside, inside), next(flat))

        diffuse = torch.sigmoid(layer(0, phi))
        specular = torch.tanh(layer(2, layer(1, torch.cat([phi, basis], 1)).relu()))
        read = torch.cat([phi, diffuse.detach() if apart else diffuse], 1)
        outputs = layer(5, layer(4, layer(3, read).relu()))
        raw = softplus(outputs[:, : self.bases]) + MIN_WEIGHT
        offsets = outputs[:, self.bases : 4 * self.bases].reshape(-1, self.bases, 3)
        return Parts(diffuse, specular, raw / raw.sum(1, keepdim=True), offsets, softplus(outputs[:, -1:]))
