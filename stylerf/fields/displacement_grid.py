"""A field's displacement grid: its gradients, from those of densities and colors, and the vertices that matter."""

import numpy as np
from scipy.ndimage import binary_dilation, distance_transform_edt

from stylerf.fields.marching import displacement_arrays, occupancy_arrays, space_arrays
from stylerf.fields.occupancy_grid import OccupancyGrid
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.kernels.cpu.compositing import visible_weights
from stylerf.kernels.cpu.deformation import displaced_cells, displacement_backward, mark_cells
from stylerf.kernels.cpu.ray_samples import Rays, Samples


def position_gradients(
    density, color, samples: Samples, basis, sigma_gradients, colors, color_gradients, threads: int
) -> np.ndarray:
    """Return dL/dx' [n, 3] of displaced positions, set only in samples.starts:ends.

    density or color may be None: that part then counts as fixed in space.
    """
    out = np.zeros(samples.x.shape, np.float32)  # zeros_like would touch the pages of the padding between threads
    if density is not None:
        density.add_position_gradients(samples, sigma_gradients, out, threads)
    if color is not None:
        points = samples.shading_points()
        color.add_position_gradients(points, basis, colors, color_gradients, out, threads)
    return out


def displacement_gradient(
    space: SpaceWarp, rays: Rays, samples: Samples, gradients: np.ndarray, vertices: int, to: np.ndarray
) -> None:
    """Add dL/dD to the threads' buffers `to` [threads, 3 vertices^3], from dL/dx' [n, 3]; D: [vertices]^3 x 3."""
    displacement_backward(space_arrays(space), rays, samples, gradients, vertices, to)


def displaced_occupancy(occupancy: OccupancyGrid, displacement: np.ndarray) -> OccupancyGrid:
    """Return the occupancy of x with x + D(x) in an occupied cell; displacement: [m, m, m, 3], cube units."""
    reach = int(np.ceil(np.abs(displacement).max() * occupancy.cells)) + 1
    occupied = np.zeros(occupancy.cells**3, np.bool_)
    displaced_cells(occupancy_arrays(occupancy), displacement_arrays(displacement), reach, occupied)
    moved = OccupancyGrid(occupancy.cells, occupancy.highest)
    moved.set_occupied(occupied)
    return moved


def at_rest(field: RadianceField) -> None:
    """Remove a field's deformation and recompute its occupancy from its own densities.

    The occupancy of a deformed field marks the cells that displacement maps to something, not the cells that hold it.
    """
    if field.displacement is None:
        return
    field.displacement = None
    field.occupancy = OccupancyGrid(field.occupancy.cells, field.occupancy.highest)
    field.occupancy.decide(field.step)


def seen_cells(field: RadianceField, rays: Rays, cells: int, weight_threshold: float, threads: int) -> np.ndarray:
    """Return [cells, cells, cells] bool: the cells of an even grid over the cube in which rays see the field.

    weight_threshold: part of its ray's largest weight that a sample needs to be seen.
    """
    seen = np.zeros((cells,) * 3, np.bool_)
    for at in range(0, len(rays.origins), 8192):
        samples = field.march(Rays(*(array[at : at + 8192] for array in rays)), 512, 1e-3, threads)
        visible = np.empty_like(samples.weights)
        visible_weights(samples, np.float32(weight_threshold), threads, visible)
        mark_cells(samples.shading_points(visible), cells + 1, seen)
    return seen


def vertices_of(seen: np.ndarray) -> np.ndarray:
    """Return ascending flat indices of the vertices of seen cells, on a grid of one vertex more per side."""
    vertices = np.zeros([side + 1 for side in seen.shape], np.bool_)
    for corner in np.ndindex(2, 2, 2):
        vertices[tuple(slice(low, low + side) for low, side in zip(corner, seen.shape))] |= seen
    return np.flatnonzero(vertices)


def occupancy_of_seen(field: RadianceField, rays: Rays, threads: int) -> OccupancyGrid:
    """Return the field's occupancy without the cells that no ray sees (fern: 28 % of all cells instead of 40 %).

    Kept are cells that hold a fiftieth of some ray's largest weight, and their neighbors.
    """
    rest = field.occupancy
    seen = binary_dilation(seen_cells(field, rays, rest.cells, 0.02, threads), np.ones((3, 3, 3)))
    found = OccupancyGrid(rest.cells, rest.highest)
    found.set_occupied(seen.ravel() & (rest.distances == 0))
    return found


def nearest_of(chosen: np.ndarray, vertices: int) -> np.ndarray:
    """Return, for each vertex of a [vertices]^3 grid, the position in `chosen` (flat indices) of the nearest one."""
    away = np.ones(vertices**3, np.bool_)
    away[chosen] = False
    number = np.zeros(vertices**3, np.int64)
    number[chosen] = np.arange(len(chosen))
    where = distance_transform_edt(away.reshape((vertices,) * 3), return_distances=False, return_indices=True)
    return number[np.ravel_multi_index(tuple(where), (vertices,) * 3).ravel()]
