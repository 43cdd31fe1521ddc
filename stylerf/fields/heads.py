"""Colour heads: what turns a place's features and a direction into a colour. Each is pure: its numbers are handed in."""

import numpy as np

from stylerf.geometry.harmonics import BANDS, C0
from stylerf.kernels.cpu import heads as kernels
from stylerf.kernels.cpu.heads import count_marked, hide, pack_marked


class Packed:
    """Samples to be coloured: index[i], of ray ray[i], ascending; their colours go to `out` [n, 3]."""

    def __init__(self, marks: np.ndarray, bound: float, starts: np.ndarray, ends: np.ndarray, chunks: int) -> None:
        counts, bound = np.empty(len(ends), np.int64), np.float32(bound)
        count_marked(marks, bound, starts, ends, chunks, counts)
        offsets = np.concatenate([[0], np.cumsum(counts)])
        self.index, self.ray = np.empty(offsets[-1], np.int64), np.empty(offsets[-1], np.int64)
        pack_marked(marks, bound, starts, ends, offsets, chunks, self.index, self.ray)


class LinearHead:
    """sigmoid(bias + sum_b Y_b(d) head_b . phi): features to spherical-harmonic coefficients.

    numbers: head [3, bands, features], bias [3].
    """

    kind = "linear"

    def __init__(self, features: int, degree: int) -> None:
        self.features, self.degree = features, degree
        self._widths = (np.int8(0),) * features

    @property
    def length(self) -> int:
        """How many numbers it has."""
        return 3 * BANDS[self.degree] * self.features + 3

    def initial(self, generator: np.random.Generator) -> np.ndarray:
        """Random, little dependent on the direction, around an even grey."""
        head = generator.uniform(-1, 1, (3, BANDS[self.degree], self.features)) / np.sqrt(self.features) / C0
        head[:, 1:] *= 0.1
        return np.append(head.ravel(), np.zeros(3)).astype(np.float32)

    def colours(self, phi, numbers, basis, packed: Packed, chunks: int, out: np.ndarray) -> None:
        """Colours of packed samples of features phi [m, features], into out [n, 3]."""
        kernels.linear(phi, self._widths, numbers, basis, packed.index, packed.ray, chunks, out)

    def backward(self, phi, numbers, basis, packed, colours, colour_gradients, at: int, to: np.ndarray) -> np.ndarray:
        """dL/d(phi) [m, features]; dL/d(numbers) is added to the chunks' buffers to[:, at:]."""
        out = np.empty_like(phi)
        kernels.linear_backward(
            phi,
            self._widths,
            numbers,
            basis,
            packed.index,
            packed.ray,
            colours,
            colour_gradients,
            len(to),
            out,
            at,
            to,
        )
        return out

    def describe(self) -> dict:
        return {"kind": self.kind, "degree": self.degree}


HEADS = {head.kind: head for head in (LinearHead,)}


def hidden_from_view(starts: np.ndarray, ends: np.ndarray, rows: int, chunks: int) -> np.ndarray:
    """[rows, 3] for colours, none of the samples having one yet."""
    out = np.empty((rows, 3), np.float32)
    hide(starts, ends, chunks, out)
    return out
