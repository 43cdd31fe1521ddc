"""Fields whose surface is known: a ball and the procedural still life, as voxel grids of their signed distance."""

from collections.abc import Callable

import numpy as np

from stylerf.fields.hash_grid import HashColor
from stylerf.fields.occupancy_grid import OccupancyGrid
from stylerf.fields.protocol import Capacity
from stylerf.fields.radiance_field import RadianceField
from stylerf.fields.voxel import Grid, VoxelDensity
from stylerf.geometry.space_warp import SpaceWarp

RADIUS = 0.5


def ball(points: np.ndarray) -> np.ndarray:
    return np.linalg.norm(points, axis=1) - RADIUS


def solid(
    distance: Callable[[np.ndarray], np.ndarray], space: SpaceWarp, resolution: int = 64, sharpness: float = 1.5
) -> RadianceField:
    """A field that is dense where the signed distance of world points [n, 3] is negative.

    Its raw density falls by e^2 per grid cell of the cube across the surface, where a cell is half opaque; its colors
    are those of positions in the cube, as sRGB.
    """
    grid = Grid.of(Capacity(size=np.full(3, resolution), resolution=resolution))
    world = space.unwarp(np.clip(grid.vertices(), 1e-6, 1 - 1e-6))
    step = 1e-4
    nearby = space.unwarp(np.clip(grid.vertices(), 1e-6, 1 - 1e-6) + step * np.array([1, 0, 0]))
    cell = np.linalg.norm(nearby - world, axis=1) / step / resolution  # world units
    exponents = np.log(np.log(2) * resolution / 100) - sharpness * distance(world) / cell
    logits = np.zeros((33, 33, 33, 4), np.float32)
    levels = np.linspace(0.02, 0.98, 33)
    logits[..., :3] = np.stack(np.meshgrid(*[np.log(levels / (1 - levels))] * 3, indexing="ij"), -1)
    return RadianceField(
        space=space,
        density=VoxelDensity(grid, np.append(np.clip(exponents, -14, 6), 0).astype(np.float32)),
        color=HashColor(levels=1, base=32, finest=32, table=1 << 16, values=logits.ravel()),
        occupancy=OccupancyGrid(32),
        step=0.5 / resolution,
    )
