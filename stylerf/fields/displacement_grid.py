"""A field's displacement grid: gradients, from those of its densities and colors, and where it matters."""

import numpy as np
from scipy.ndimage import binary_dilation, distance_transform_edt

from stylerf.fields.occupancy_grid import OccupancyGrid
from stylerf.fields.radiance_field import RadianceField
from stylerf.fields.ray_samples import Rays, Samples
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.kernels.cpu.compositing import significant
from stylerf.kernels.cpu.deformation import displaced_cells, displacement_backward, mark_cells


def position_gradients(
    density, color, samples: Samples, basis, sigma_gradients, colors, color_gradients, chunks: int
) -> np.ndarray:
    """dL/dx' [n, 3] of displaced positions; density or color may be None, to take its part as fixed in space.

    Only what lies in samples.starts:ends is set.
    """
    out = np.zeros(samples.x.shape, np.float32)  # zeros_like would touch the room between chunks
    if density is not None:
        density.add_position_gradients(samples, sigma_gradients, out, chunks)
    if color is not None:
        color.add_position_gradients(samples, basis, colors, color_gradients, out, chunks)
    return out


def displacement_gradient(
    space: SpaceWarp, rays: Rays, samples: Samples, gradients: np.ndarray, cells: int, to: np.ndarray
) -> None:
    """Add dL/dD to the chunks' buffers `to` [chunks, 3 cells^3], from dL/dx' [n, 3]; D is [cells, cells, cells, 3]."""
    displacement_backward(
        space.code,
        space.packed(),
        rays.origins,
        rays.directions,
        samples.t,
        samples.optical,
        samples.x,
        samples.starts,
        samples.ends,
        gradients,
        cells,
        len(to),
        to,
    )


def displaced_occupancy(occupancy: OccupancyGrid, displacement: np.ndarray) -> OccupancyGrid:
    """The occupancy of x with x + D(x) in an occupied cell; displacement: [m, m, m, 3], cube units."""
    cells = occupancy.cells
    reach = int(np.ceil(np.abs(displacement).max() * cells)) + 1
    occupied = np.zeros(cells**3, np.bool_)
    displaced_cells(occupancy.distances, cells, reach, displacement.reshape(-1), displacement.shape[0], occupied)
    moved = OccupancyGrid(cells, occupancy.highest)
    moved.set_occupied(occupied)
    return moved


def at_rest(field: RadianceField) -> None:
    """Take the deformation away from a field: where it is occupied is decided anew, from its own densities.

    A deformed field keeps the cells that lead to something once they are moved, which are not those of what it holds.
    """
    if field.displacement is None:
        return
    field.displacement = None
    field.occupancy = OccupancyGrid(field.occupancy.cells, field.occupancy.highest)
    field.occupancy.decide(field.step)


def seen_cells(field: RadianceField, rays: Rays, cells: int, share: float, chunks: int) -> np.ndarray:
    """[cells, cells, cells] bool: cells of an even grid over the cube that rays see something of the field in.

    share: part of its ray's largest weight that a sample needs to be seen.
    """
    seen = np.zeros((cells,) * 3, np.bool_)
    for at in range(0, len(rays.origins), 8192):
        part = slice(at, at + 8192)
        some = Rays(rays.origins[part], rays.directions[part], rays.jitter[part], rays.near[part])
        samples = field.march(some, 512, 1e-3, chunks)
        shown = np.empty_like(samples.weights)
        significant(samples.weights, samples.starts, samples.ends, np.float32(share), chunks, shown)
        mark_cells(shown, samples.x, samples.starts, samples.ends, cells + 1, seen)
    return seen


def vertices_of(seen: np.ndarray) -> np.ndarray:
    """Flat indices, ascending, of the vertices of the cells that are seen, on a grid of one vertex more a side."""
    vertices = np.zeros([side + 1 for side in seen.shape], np.bool_)
    for corner in np.ndindex(2, 2, 2):
        vertices[tuple(slice(low, low + side) for low, side in zip(corner, seen.shape))] |= seen
    return np.flatnonzero(vertices)


def occupancy_of_seen(field: RadianceField, rays: Rays, chunks: int) -> OccupancyGrid:
    """The field's occupancy without what no ray sees: behind surfaces and in fog (fern: 28 % of the cells, of 40 %).

    Kept are cells that hold a fiftieth of some ray's largest weight, and those around them.
    """
    rest = field.occupancy
    seen = binary_dilation(seen_cells(field, rays, rest.cells, 0.02, chunks), np.ones((3, 3, 3)))
    found = OccupancyGrid(rest.cells, rest.highest)
    found.set_occupied(seen.ravel() & (rest.distances == 0))
    return found


def nearest_of(chosen: np.ndarray, vertices: int) -> np.ndarray:
    """For each vertex of a [vertices]^3 grid, the place in `chosen` (flat indices) of the nearest chosen vertex."""
    away = np.ones(vertices**3, np.bool_)
    away[chosen] = False
    number = np.zeros(vertices**3, np.int64)
    number[chosen] = np.arange(len(chosen))
    where = distance_transform_edt(away.reshape((vertices,) * 3), return_distances=False, return_indices=True)
    return number[np.ravel_multi_index(tuple(where), (vertices,) * 3).ravel()]
