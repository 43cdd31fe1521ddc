"""Marching rays through a density of any kind: what the kinds' kernels share."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stylerf.fields.occupancy_grid import OccupancyGrid
from stylerf.fields.scratch_arena import ScratchArena, empty_array
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.kernels.cpu.ray_samples import Density, Displacement, MarchSettings, Occupancy, Rays, Samples, Space

NO_DISPLACEMENT = Displacement(np.empty(0, np.float32), 0)


@dataclass(frozen=True)
class MarchInputs:
    """What a march reads beside the rays and the density; see kernels/cpu/ray_samples.py."""

    space: Space
    occupancy: Occupancy
    displacement: Displacement
    settings: MarchSettings
    threads: int
    arena: ScratchArena | None = None


def space_arrays(space: SpaceWarp) -> Space:
    """Return a warp of space as the kernels take it."""
    return Space(space.code, space.packed(), np.float32(space.far))


def occupancy_arrays(occupancy: OccupancyGrid) -> Occupancy:
    """Return an occupancy grid as the kernels take it."""
    return Occupancy(occupancy.distances, occupancy.cells)


def displacement_arrays(displacement: np.ndarray | None) -> Displacement:
    """Return a displacement grid [m, m, m, 3], or none, as the kernels take it."""
    return NO_DISPLACEMENT if displacement is None else Displacement(displacement.reshape(-1), len(displacement))


def march(kernel: Callable, density: Density, shape: tuple, rays: Rays, inputs: MarchInputs) -> Samples:
    """March rays by the kernel of one kind of density.

    Args:
        kernel: march_density of that kind.
        density: its numbers. shape: the tuple whose length its kernel needs at compile time.
        rays: [rays]. inputs: everything else.

    Returns:
        Samples with room for samples_per_ray on every ray; only the pages that are written take memory.
    """
    n, arena = len(rays.origins), inputs.arena
    size = n * inputs.settings.samples_per_ray
    t, deltas, sigma, weights = (empty_array((size,), arena) for _ in range(4))
    starts, ends = np.empty(n, np.int64), np.empty(n, np.int64)
    samples = Samples(starts, ends, t, deltas, empty_array((size, 3), arena), sigma, weights)
    kernel(
        density, shape, rays, inputs.space, inputs.occupancy, inputs.displacement, inputs.settings, inputs.threads,
        samples,
    )  # fmt: skip
    return samples
