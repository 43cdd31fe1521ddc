"""What every kind of density and color offers, so that a field may be made of any two and every stage works with it.

All that a part can learn is one flat float32 array `values`: gradients are buffers [chunks, len(values)], one for each
of the chunks that a kernel works in parallel, summed in order by the optimizer. Positions x are [n, 3] float32 in the
unit cube, as the field is asked (displaced). Samples of ray r are starts[r]:ends[r]; what lies between belongs to no
ray and is neither read nor written. Every result is the same to the bit for the same number of chunks.

A part holds no other state that decides its answers than `values` and what `describe` tells: `restore` of the two is
the same part, to the bit. Parts that stand over others (fields/region_color.py) name their further arrays to the field.
"""

from typing import Protocol, runtime_checkable

import numpy as np

from stylerf.fields.capacity import Capacity
from stylerf.fields.ray_samples import Rays, Samples


class Part(Protocol):
    """Common to density and color."""

    kind: str
    values: np.ndarray

    def groups(self) -> list[tuple[int, int, float]]:
        """(begin, end, learning-rate factor) of parts of `values`; what is in none of them never learns."""

    def smooth(self, strength: float, to: np.ndarray) -> None:
        """Add the gradient of `strength` times the part's total variation to one buffer `to` [len(values)]."""

    def describe(self) -> dict:
        """JSON form of everything that is not in `values`; its "kind" says who restores it."""

    @classmethod
    def restore(cls, data: dict, values: np.ndarray) -> "Part":
        """From describe() and `values`."""


@runtime_checkable
class Growing(Protocol):
    """What a part needs beside to be fitted by a ladder of capacities (training/fit/capacity_levels.py)."""

    def grown(self, capacity: Capacity, generator: np.random.Generator) -> "Growing":
        """The same part at a larger capacity: as near to the same answers as that can say, to be taught further."""


@runtime_checkable
class DensityPart(Part, Protocol):
    """Raw density: optical depth per hundredth of the unit cube (docs/decisions/0002)."""

    def sigma(self, x: np.ndarray, chunks: int) -> np.ndarray:
        """Raw density [n] of points [n, 3]."""

    def march(
        self,
        space,
        rays: Rays,
        occupancy,
        step: float,
        displacement: tuple[np.ndarray, int],
        limit: int,
        opaque: float,
        closed: bool,
        chunks: int,
    ) -> Samples:
        """Samples of rays with density and weights; see kernels/cpu/march.walk_chunk."""

    def backward(self, x, starts, ends, sigma, sigma_gradients, to: np.ndarray) -> None:
        """Add dL/d(values) to the chunks' buffers `to` [chunks, len(values)]; sigma, sigma_gradients [n]."""

    def add_position_gradients(self, samples: Samples, sigma_gradients, out: np.ndarray, chunks: int) -> None:
        """Add dL/dx to out [n, 3]; on a cell's side the slope is that of one of its cells."""


@runtime_checkable
class ColorPart(Part, Protocol):
    """Colors 0..1, sRGB-encoded, seen from a direction."""

    degree: int  # of the spherical harmonics that it is handed; 0 where the color is the same from everywhere

    def colors(self, x, basis, starts, ends, weights, least: float, chunks: int) -> np.ndarray:
        """[n, 3] colors of samples with weight > least; others have -1 in the first channel.

        basis [rays, bands]: spherical harmonics of the rays' directions (None: for parts that do not ask).
        """

    def backward(self, x, basis, starts, ends, colors, color_gradients, to: np.ndarray) -> None:
        """Add dL/d(values) to the chunks' buffers `to`; colors as colors() gave them, color_gradients [n, 3]."""

    def add_position_gradients(
        self, samples: Samples, basis, colors: np.ndarray, color_gradients: np.ndarray, out: np.ndarray, chunks: int
    ) -> None:
        """Add dL/dx to out [n, 3]."""
