"""The interface of every kind of density and color, by which a field may combine any two.

Conventions:
    values      all that a part learns, one flat float32 array. Gradients are buffers [threads, len(values)], one per
                thread of the kernels, summed in order by the optimizer: results repeat to the bit for the same number
                of threads.
    positions   x [n, 3] float32 in the unit cube, after displacement.
    state       `values` and describe() are all the state there is: restore() of the two is the same part, to the bit.
                A region's color (fields/region_color.py) and a blend (fields/blended_color.py) hold other parts and
                further arrays, which the field saves.

The parts on a GPU (fields/gpu) are apart: tensors instead of arrays, directions instead of a basis, and colors chosen
by a threshold relative to each ray's largest weight (`visible_colors`).
"""

from dataclasses import dataclass
from typing import Protocol, Self, runtime_checkable

import numpy as np

from stylerf.fields.marching import MarchInputs, ScratchArena
from stylerf.fields.occupancy_grid import OccupancyGrid
from stylerf.kernels.cpu.ray_samples import Rays, Samples, ShadingPoints


@dataclass(frozen=True)
class Capacity:
    """The size of a part: one description that every kind interprets, so that one search serves all kinds.

    Attributes:
        size: [3] vertices per axis of grids and planes.
        resolution: their mean, and the most cells per side of a hash level.
        density_rank, color_rank: ranks of vm parts.
        table: most vertices of a hash level. levels: number of hash levels. finest: cells per side of the finest one.
        occupancy: selects the blocks that a voxel grid allocates (None: all) and weights the pruning of ranks.
        degree: of the color's spherical harmonics.
    """

    size: np.ndarray
    resolution: int
    density_rank: int = 16
    color_rank: int = 24
    table: int = 1 << 16
    levels: int = 8
    finest: int = 256
    occupancy: OccupancyGrid | None = None
    degree: int = 1


class Part(Protocol):
    """What density and color have in common."""

    kind: str

    @property
    def values(self) -> np.ndarray:
        """All that learns, written in place."""

    def groups(self) -> list[tuple[int, int, float]]:
        """Return (begin, end, learning-rate factor) of slices of `values`; anything outside them never learns."""

    def smooth(self, strength: float, to: np.ndarray) -> None:
        """Add the gradient of `strength` times the part's total variation to one buffer `to` [len(values)]."""

    def describe(self) -> dict:
        """Return everything but the arrays, as JSON; "kind" selects the class that restores it."""


class Restorable(Protocol):
    """A part whose describe() and `values` are all the state there is."""

    @classmethod
    def restore(cls, data: dict, values: np.ndarray) -> Self:
        """Rebuild a part.

        Raises:
            InvalidValue: the two do not make a valid part.
        """


@runtime_checkable
class Growing(Protocol):
    """A part that the capacity search can enlarge (training/fit/settings.py)."""

    def grown(self, capacity: Capacity, generator: np.random.Generator) -> Self:
        """Return the same function at a larger capacity, as closely as that can represent it."""


@runtime_checkable
class DensityPart(Part, Restorable, Protocol):
    """Raw density: optical depth per hundredth of the unit cube (decision 0002)."""

    def sigma(self, x: np.ndarray, threads: int) -> np.ndarray:
        """Return raw density [n] at points [n, 3]."""

    def march(self, rays: Rays, inputs: MarchInputs) -> Samples:
        """March rays to samples with density and weights; see kernels/cpu/march.march_partition."""

    def backward(self, samples: Samples, sigma_gradients: np.ndarray, to: np.ndarray) -> None:
        """Add dL/d(values) to the threads' buffers `to` [threads, len(values)], from dL/d(sigma) [n]."""

    def add_position_gradients(self, samples: Samples, sigma_gradients, out: np.ndarray, threads: int) -> None:
        """Add dL/dx to out [n, 3]; between two cells the slope is that of one of them."""


@runtime_checkable
class ColorPart(Part, Protocol):
    """Colors 0..1, sRGB-encoded, that may depend on the view direction."""

    @property
    def degree(self) -> int:
        """Of the spherical harmonics it reads; 0: the color does not depend on the view."""

    def colors(
        self, points: ShadingPoints, basis: np.ndarray, threads: int, arena: ScratchArena | None = None
    ) -> np.ndarray:
        """Color the points of positive weight.

        Args:
            points: positions along rays and their weights.
            basis: [rays, bands], spherical harmonics of the rays' directions.
            threads: partitions of the rays.
            arena: where the result's memory comes from; None: new memory.

        Returns:
            [n, 3] in 0..1; points on rays that have no positive weight have -1 in the first channel.
        """

    def backward(self, points: ShadingPoints, basis, colors, color_gradients, to: np.ndarray) -> None:
        """Add dL/d(values) to the threads' buffers `to`, given colors() [n, 3] and dL/d(colors) [n, 3]."""

    def add_position_gradients(self, points: ShadingPoints, basis, colors, color_gradients, out, threads: int) -> None:
        """Add dL/dx to out [n, 3]."""


class RestorableColor(ColorPart, Restorable, Protocol):
    """Every color but a region's and a blend, which have further arrays."""
