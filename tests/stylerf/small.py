"""Small fields, spaces and rays that the tests of kernels, rendering and training share; the oracle's view of samples.

Ranks 16 and 24 and 8 hash levels are those that `fit` and `stylize` compile.
"""

from dataclasses import dataclass

import numpy as np
import torch

from stylerf.fields.encoded_color import EncodedColor
from stylerf.fields.hash_grid import HashColor, HashDensity, Levels
from stylerf.fields.occupancy_grid import OccupancyGrid
from stylerf.fields.protocol import Capacity
from stylerf.fields.radiance_field import RadianceField
from stylerf.fields.vm import VmColor, VmDensity
from stylerf.fields.voxel import Grid, VoxelDensity
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.kernels.cpu.march import OPTICAL_SCALE
from stylerf.kernels.cpu.ray_samples import Rays, Samples
from tests.stylerf.kernels import torch_reference

DENSITY_RANK, COLOR_RANK = 16, 24
SIZE = (7, 6, 8)

SPACES = {
    "box": SpaceWarp.box([-1, -0.8, -0.5], [1.2, 0.9, 0.7]),
    "contraction": SpaceWarp.box([-1, -0.8, -0.5], [1.2, 0.9, 0.7], near=0.05, far=1e3, kind="contraction"),
    "frustum": SpaceWarp.frustum(0.7, 0.6, 1.0, 1e4),
}


def float64(array: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.asarray(array, np.float64).copy())


def close(found, expected, rounding: float, what: str = "") -> None:
    """Equal up to `rounding` times the largest number expected: sums in float32 lose that much and no more."""
    found, expected = (np.asarray(v.detach() if torch.is_tensor(v) else v, np.float64) for v in (found, expected))
    largest = np.abs(expected).max() if expected.size else 0.0
    np.testing.assert_allclose(found, expected, rtol=rounding, atol=rounding * largest, err_msg=what)


def density(seed: int, size=SIZE, rank: int = DENSITY_RANK, shift: float = -2.0) -> VmDensity:
    """A fog whose raw density varies a few times over around exp(shift)."""
    made = VmDensity.create(np.array(size), rank, np.random.default_rng(seed), shift)
    made.values[:-1] = np.random.default_rng(seed).normal(scale=0.5, size=len(made.table))
    return made


def vm_color(seed: int, size=SIZE, rank: int = COLOR_RANK, degree: int = 1) -> VmColor:
    made = VmColor.create(np.array(size), rank, degree, np.random.default_rng(seed))
    made.values[: len(made.table)] = np.random.default_rng(seed).normal(scale=0.6, size=len(made.table))
    made.values[-3:] = 0.3, -0.2, 0.1
    return made


def hash_color(seed: int, levels: int = 8, base: int = 3, finest: int = 40, table: int = 512) -> HashColor:
    """Coarse levels are indexed directly (4^3 and 6^3 vertices), fine ones are hashed."""
    made = HashColor.create(np.random.default_rng(seed), levels, base, finest, table)
    made.values[:] = np.random.default_rng(seed).normal(scale=0.4, size=len(made.values))
    return made


def half_empty(cells: int = 8) -> OccupancyGrid:
    """Occupied in one corner of the cube only, so that a voxel grid leaves blocks out."""
    made = OccupancyGrid(cells)
    full = np.zeros((cells,) * 3, bool)
    full[: cells // 4, : cells // 2, : cells // 2] = True
    made.set_occupied(full.ravel())
    return made


SMALL = Capacity(np.array(SIZE), 40, DENSITY_RANK, COLOR_RANK, table=512, levels=8, finest=64)
# As small, but with room for blocks that are not kept.
SPARSE = Capacity(np.array([18, 14, 17]), 40, DENSITY_RANK, COLOR_RANK, occupancy=half_empty())


def hash_density(seed: int, capacity: Capacity = SMALL) -> HashDensity:
    """Direct, hashed and (above 40 cells a side) waiting levels."""
    made = HashDensity.create(capacity, np.random.default_rng(seed), -2.0)
    made.values[:-1] = np.random.default_rng(seed).normal(scale=0.3, size=len(made.table))
    return made


def voxel_density(seed: int, capacity: Capacity = SPARSE) -> VoxelDensity:
    made = VoxelDensity.create(capacity, np.random.default_rng(seed), -2.0)
    made.values[:-1] = np.random.default_rng(seed).normal(scale=0.6, size=len(made.table))
    return made


def headed(seed: int, kind: str, head: str, degree: int = 1, capacity: Capacity = SMALL) -> EncodedColor:
    made = EncodedColor.create(kind, head, capacity, degree, np.random.default_rng(seed))
    made.table[:] = np.random.default_rng(seed).normal(scale=0.6, size=len(made.table))
    if made.head.length:
        made.numbers[-3:] = 0.3, -0.2, 0.1
    return made


def occupied(cells: int = 8) -> OccupancyGrid:
    """Every cell is occupied: nothing is skipped."""
    return OccupancyGrid(cells)


def rays_into(space: SpaceWarp, count: int, seed: int, jitter: bool = True) -> Rays:
    """Rays through the middle of the space from around it (or, into a frustum, along its axis)."""
    generator = np.random.default_rng(seed)
    if space.kind == "frustum":
        origins = generator.uniform(-0.2, 0.2, (count, 3))
        directions = generator.uniform([-0.5, -0.4, 1], [0.5, 0.4, 1], (count, 3))
    else:
        way = generator.normal(size=(count, 3))
        origins = (1.9 if space.kind == "contraction" else 2.5) * way / np.linalg.norm(way, axis=1, keepdims=True)
        directions = generator.uniform(-0.4, 0.4, (count, 3)) - origins
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    where = generator.random(count).astype(np.float32) if jitter else None
    return Rays.of(origins.astype(np.float32), directions.astype(np.float32), space.near, where)


def field_of(space: SpaceWarp, seed: int, color=None, step: float = 1 / 24, displacement=None) -> RadianceField:
    made = vm_color(seed + 1) if color is None else color
    return RadianceField(space, density(seed), made, occupied(), step, displacement)


def wall_in_front(transmittance: float, backs: bool = False) -> RadianceField:
    """A frustum that holds a wall at z = 3 of such a transmittance; backs: another one like it at z = 6.

    The walls are one cell of the cube thick; a ray along the axis is asked four times in each.
    """
    space, cells = SpaceWarp.frustum(0.7, 0.6, 1.0, 1e4), 96
    made = field_of(space, 1, hash_color(2), step=1 / (4 * cells))
    made.density = density(0, size=(2, 2, 2))
    made.density.values[:-1] = 0
    made.density.values[-1] = np.log(-np.log(transmittance) * cells / OPTICAL_SCALE)
    solid = np.zeros((cells, cells, cells), bool)
    solid[..., 64] = True  # 1 - near / z = 2/3
    solid[..., 80] = backs
    made.occupancy = OccupancyGrid(cells)
    made.occupancy.set_occupied(solid.ravel())
    return made


def displacement_grid(seed: int, cells: int = 5, reach: float = 0.05) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-reach, reach, (cells, cells, cells, 3)).astype(np.float32)


@dataclass
class Packed:
    """What lies on the rays, ray after ray, as float64: the form the oracle takes. at: indices into Samples' arrays."""

    at: np.ndarray
    rays: torch.Tensor
    t: torch.Tensor
    deltas: torch.Tensor
    x: torch.Tensor
    sigma: torch.Tensor
    weights: torch.Tensor

    @property
    def background(self) -> torch.Tensor:
        return self.deltas == 0

    @staticmethod
    def of(samples: Samples) -> "Packed":
        spans = [np.arange(a, b) for a, b in zip(samples.starts, samples.ends)]
        at = np.concatenate(spans) if spans else np.empty(0, np.int64)
        rays = np.repeat(np.arange(len(samples.ends)), samples.ends - samples.starts)
        parts = (
            float64(array[at]) for array in (samples.t, samples.deltas, samples.x, samples.sigma, samples.weights)
        )
        return Packed(at, torch.from_numpy(rays), *parts)


def points_on(rays: Rays, packed: Packed) -> tuple[torch.Tensor, torch.Tensor]:
    """World positions and directions [n, 3] of packed samples."""
    directions = float64(rays.directions)[packed.rays]
    return float64(rays.origins)[packed.rays] + packed.t[:, None] * directions, directions


def oracle_color(color, values: torch.Tensor, basis: torch.Tensor, x: torch.Tensor) -> torch.Tensor:
    if color.kind == "hash":
        return torch_reference.hash_color(values, color.levels, color.base, color.finest, color.table, x)
    if color.kind == "headed":
        length = color.features.length
        phi = oracle_features(color.features, values[:length], x)
        return getattr(torch_reference, f"{color.head.kind}_head")(values[length:], phi, basis)
    return torch_reference.vm_color(values, color.size.tolist(), color.rank, basis, x)


def oracle_levels(levels: Levels, table: torch.Tensor, x: torch.Tensor) -> torch.Tensor:
    shape = levels.count, levels.base, levels.finest, levels.table
    return torch_reference.hash_levels(table, *shape, x, levels.width, levels.active)


def oracle_grid(grid: Grid, table: torch.Tensor, width: int, x: torch.Tensor) -> torch.Tensor:
    return torch_reference.voxel_rows(table, torch.from_numpy(grid.kept), grid.size.tolist(), width, x)


def oracle_features(features, table: torch.Tensor, x: torch.Tensor) -> torch.Tensor:
    if features.kind == "vm":
        return torch_reference.vm_features(table, features.size.tolist(), features.rank, x)
    if features.kind == "voxel":
        return oracle_grid(features.grid, table, features.width, x)
    return oracle_levels(features.levels, table, x).flatten(1)


def oracle_density(density, values: torch.Tensor, x: torch.Tensor) -> torch.Tensor:
    if density.kind == "hash":
        return torch_reference.raw_density(values[-1] + oracle_levels(density.levels, values[:-1], x).sum((1, 2)))
    if density.kind == "voxel":
        return torch_reference.raw_density(values[-1] + oracle_grid(density.grid, values[:-1], 1, x)[:, 0])
    return torch_reference.vm_density(values, density.size.tolist(), density.rank, x)


def oracle_pixels(field, rays, rendered, density_values, color_values, grid=None) -> tuple[torch.Tensor, torch.Tensor]:
    """([rays, 5], warped positions [n, 3]) of the samples that the kernels chose, from values that may need gradients.

    The kernels decide where samples lie and which take their ray's mean; all else is worked out again.
    """
    packed = Packed.of(rendered.samples)
    x = torch_reference.warp(field.space, points_on(rays, packed)[0])
    if grid is not None:
        x = torch.where(packed.background[:, None], x, torch_reference.displaced(grid, x))
    sigma = oracle_density(field.density, density_values, x)
    weights, _ = torch_reference.weights(sigma, packed.deltas, packed.rays, packed.background)
    basis = float64(rendered.basis)[packed.rays]
    colors = oracle_color(field.color, color_values, basis, x)
    colored = torch.from_numpy(rendered.colors[packed.at, 0] >= 0)
    t = torch.where(packed.background, 0, packed.t)
    return torch_reference.composite(weights, colors, colored, t, packed.rays, len(rays.origins)), x
