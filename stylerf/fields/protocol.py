"""The interface shared by all kinds of density and color, so that a field can combine any two.

Conventions:
    values      all learnable parameters of a part, one flat float32 array. Gradients are buffers
                [threads, len(values)], one per kernel thread, summed in order by the optimizer, so that results are
                bit-identical for the same number of threads.
    positions   x [n, 3] float32 in the unit cube, after displacement.
    state       `values` and describe() are the complete state: restore() rebuilds a bit-identical part from them.
                A region's color (fields/region_color.py) and a blend (fields/blended_color.py) hold other parts and
                additional arrays, which the field saves.

GPU parts (fields/gpu) have a separate interface: tensors instead of arrays, directions instead of a basis, and colors
selected by a threshold relative to each ray's largest weight (`visible_colors`).
"""

from dataclasses import dataclass
from typing import Protocol, Self, runtime_checkable

import numpy as np

from stylerf.fields.marching import MarchInputs, ScratchArena
from stylerf.fields.occupancy_grid import OccupancyGrid
from stylerf.kernels.cpu.ray_samples import Rays, Samples, ShadingPoints


@dataclass(frozen=True)
class Capacity:
    """The size of a part. Every kind interprets the same description, so that one search serves all kinds.

    Attributes:
        size: [3], vertices per axis of grids and planes.
        resolution: their mean, and the maximum cells per side of an active hash level.
        density_rank, color_rank: ranks of vm parts.
        table: maximum vertices per hash level. levels: number of hash levels. finest: cells per side of the finest one.
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
    """The common interface of density and color."""

    kind: str

    @property
    def values(self) -> np.ndarray:
        """All learnable parameters, updated in place."""

    def groups(self) -> list[tuple[int, int, float]]:
        """Return (begin, end, learning-rate factor) for slices of `values`; the rest never learns."""

    def smooth(self, strength: float, to: np.ndarray) -> None:
        """Add the gradient of `strength` times the part's total variation to one buffer `to` [len(values)]."""

    def describe(self) -> dict:
        """Return everything except the arrays, as JSON; "kind" selects the class that restores it."""


class Restorable(Protocol):
    """A part whose describe() and `values` are its complete state."""

    @classmethod
    def restore(cls, data: dict, values: np.ndarray) -> Self:
        """Rebuild a part.

        Raises:
            InvalidValue: the arguments do not describe a valid part.
        """


@runtime_checkable
class Growing(Protocol):
    """A part that the capacity search can enlarge (training/fit/settings.py)."""

    def grown(self, capacity: Capacity, generator: np.random.Generator) -> Self:
        """Return the same function with a larger capacity, as closely as that can represent it."""


@runtime_checkable
class DensityPart(Part, Restorable, Protocol):
    """Raw density: optical depth per hundredth of the unit cube (decision 0002)."""

    def sigma(self, x: np.ndarray, threads: int) -> np.ndarray:
        """Return raw density [n] at points [n, 3]."""

    def march(self, rays: Rays, inputs: MarchInputs) -> Samples:
        """March rays; return samples with density and weights. See kernels/cpu/march.march_partition."""

    def backward(self, samples: Samples, sigma_gradients: np.ndarray, to: np.ndarray) -> None:
        """Add dL/d(values) to the per-thread buffers `to` [threads, len(values)], from dL/d(sigma) [n]."""

    def add_position_gradients(self, samples: Samples, sigma_gradients, out: np.ndarray, threads: int) -> None:
        """Add dL/dx to out [n, 3]; on the boundary of two cells, the gradient of one of them is used."""


@runtime_checkable
class ColorPart(Part, Protocol):
    """Colors in 0..1, sRGB-encoded, possibly view-dependent."""

    @property
    def degree(self) -> int:
        """Degree of the spherical harmonics it reads; 0: the color is view-independent."""

    def colors(
        self, points: ShadingPoints, basis: np.ndarray, threads: int, arena: ScratchArena | None = None
    ) -> np.ndarray:
        """Color the points with positive weight.

        Args:
            points: positions along rays and their weights.
            basis: [rays, bands], spherical harmonics of the rays' directions.
            threads: partitions of the rays.
            arena: allocates the result; None: new memory.

        Returns:
            [n, 3] in 0..1; points on rays without a positive weight have -1 in the first channel.
        """

    def backward(self, points: ShadingPoints, basis, colors, color_gradients, to: np.ndarray) -> None:
        """Add dL/d(values) to the per-thread buffers `to`, given colors() [n, 3] and dL/d(colors) [n, 3]."""

    def add_position_gradients(self, points: ShadingPoints, basis, colors, color_gradients, out, threads: int) -> None:
        """Add dL/dx to out [n, 3]."""


class RestorableColor(ColorPart, Restorable, Protocol):
    """Every color except a region's and a blend, which have additional arrays."""
