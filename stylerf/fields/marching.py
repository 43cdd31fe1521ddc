"""Inputs of CPU ray marching other than rays and density, and scratch memory for samples.

A batch of rays reserves many times the memory that its samples fill. In freshly allocated memory, the operating system
maps and clears every page on first write; a scratch arena reuses the pages that the last batch has already touched.
"""

import math
from dataclasses import dataclass

import numpy as np

from stylerf.fields.occupancy_grid import OccupancyGrid
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.kernels.cpu.ray_samples import Displacement, MarchSettings, Occupancy, Space

SAMPLES_PER_RAY = 512  # at most
NO_DISPLACEMENT = Displacement(np.empty(0, np.float32), 0)


class ScratchArena:
    """Allocates uninitialized arrays, reusing the same memory after each reset().

    Arrays from an arena must not be used after its reset(). An arena serves a single thread.
    """

    def __init__(self) -> None:
        self._blocks: list[np.ndarray] = []
        self._used = 0

    def reset(self) -> "ScratchArena":
        """Invalidate all arrays; returns the arena itself."""
        self._used = 0
        return self

    def empty(self, shape: tuple[int, ...], dtype=np.float32) -> np.ndarray:
        """Return an array that overlaps no other since the last reset()."""
        dtype = np.dtype(dtype)
        length = math.prod(shape) * dtype.itemsize
        if self._used == len(self._blocks):
            self._blocks.append(np.empty(0, np.uint8))
        if len(self._blocks[self._used]) < length:
            # Batches grow gradually: with 25 % headroom, few of them need a new block.
            self._blocks[self._used] = np.empty(length + length // 4, np.uint8)
        block = self._blocks[self._used]
        self._used += 1
        return block[:length].view(dtype).reshape(shape)


def empty_array(shape: tuple[int, ...], arena: ScratchArena | None) -> np.ndarray:
    """Return an uninitialized float32 array, from the arena if there is one."""
    return np.empty(shape, np.float32) if arena is None else arena.empty(shape)


@dataclass(frozen=True)
class MarchInputs:
    """Inputs of ray marching other than rays and density; see kernels/cpu/ray_samples.py."""

    space: Space
    occupancy: Occupancy
    displacement: Displacement
    settings: MarchSettings
    threads: int
    arena: ScratchArena | None = None


def space_arrays(space: SpaceWarp) -> Space:
    return Space(space.code, space.packed(), np.float32(space.far))


def occupancy_arrays(occupancy: OccupancyGrid) -> Occupancy:
    return Occupancy(occupancy.distances, occupancy.cells)


def displacement_arrays(displacement: np.ndarray | None) -> Displacement:
    """Return a displacement grid [m, m, m, 3], or None, in the kernels' form."""
    return NO_DISPLACEMENT if displacement is None else Displacement(displacement.reshape(-1), len(displacement))
