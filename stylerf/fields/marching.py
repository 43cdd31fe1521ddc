"""Walking rays through a density of any kind: the kernel is the kind's own, the rest is common."""

import numpy as np

from stylerf.fields.occupancy_grid import OccupancyGrid
from stylerf.fields.ray_samples import Rays, Samples
from stylerf.geometry.space_warp import SpaceWarp


def walk(
    kernel,
    numbers: tuple,
    space: SpaceWarp,
    rays: Rays,
    occupancy: OccupancyGrid,
    step: float,
    displacement: tuple[np.ndarray, int],
    limit: int,
    opaque: float,
    closed: bool,
    chunks: int,
) -> Samples:
    """Samples of rays by a kind's march kernel; see kernels/cpu/march.walk_chunk.

    numbers: (table, layout, shift, shape) as that kernel takes them. displacement: (flat grid, vertices a side).
    """
    samples = Samples.empty(len(rays.origins), limit)
    kernel(
        space.code,
        space.packed(),
        rays.origins,
        rays.directions,
        rays.jitter,
        rays.near,
        np.float32(space.far),
        np.float32(step),
        occupancy.distances,
        occupancy.cells,
        limit,
        *numbers,
        *displacement,
        np.float32(opaque),
        closed,
        chunks,
        samples.starts,
        samples.ends,
        samples.t,
        samples.optical,
        samples.x,
        samples.sigma,
        samples.weights,
    )
    return samples
