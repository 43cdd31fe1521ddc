"""A field's displacement grid: gradients, from those of its densities and colours, and where it matters."""

import numpy as np
from scipy.ndimage import distance_transform_edt

from stylerf.fields.field import RadianceField
from stylerf.fields.occupancy import Occupancy
from stylerf.fields.samples import Rays, Samples
from stylerf.geometry.space import Space
from stylerf.kernels.cpu.composite import significant
from stylerf.kernels.cpu.deform import displaced_cells, displacement_backward, mark_cells


def position_gradients(
    density, colour, samples: Samples, basis, sigma_gradients, colours, colour_gradients, chunks: int
) -> np.ndarray:
    """dL/dx' [n, 3] of displaced positions; density or colour may be None, to take its part as fixed in space.

    Only what lies in samples.starts:ends is set.
    """
    out = np.zeros(samples.x.shape, np.float32)  # zeros_like would touch the room between chunks
    if density is not None:
        density.add_position_gradients(samples, sigma_gradients, out, chunks)
    if colour is not None:
        colour.add_position_gradients(samples, basis, colours, colour_gradients, out, chunks)
    return out


def displacement_gradient(
    space: Space, rays: Rays, samples: Samples, gradients: np.ndarray, cells: int, to: np.ndarray
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


def displaced_occupancy(occupancy: Occupancy, displacement: np.ndarray) -> Occupancy:
    """The occupancy of x with x + D(x) in an occupied cell; displacement: [m, m, m, 3], cube units."""
    cells = occupancy.cells
    reach = int(np.ceil(np.abs(displacement).max() * cells)) + 1
    occupied = np.zeros(cells**3, np.bool_)
    displaced_cells(occupancy.distances, cells, reach, displacement.reshape(-1), displacement.shape[0], occupied)
    moved = Occupancy(cells, occupancy.highest)
    moved.set_occupied(occupied)
    return moved


def visible_vertices(
    field: RadianceField, rays: Rays, vertices: int, share: float, chunks: int, at_once: int = 8192
) -> np.ndarray:
    """Flat indices, ascending, of the vertices of a [vertices]^3 grid around what rays see of a field at rest.

    share: part of its ray's largest weight that a sample needs to be seen.
    """
    seen = np.zeros((vertices,) * 3, np.bool_)
    for at in range(0, len(rays.origins), at_once):
        part = slice(at, at + at_once)
        some = Rays(rays.origins[part], rays.directions[part], rays.jitter[part], rays.near[part])
        samples = field.march(some, 512, 1e-3, chunks)
        shown = np.empty_like(samples.weights)
        significant(samples.weights, samples.starts, samples.ends, np.float32(share), chunks, shown)
        mark_cells(shown, samples.x, samples.starts, samples.ends, vertices, seen)
    for axis in range(3):  # a cell's lower vertex stands for the cell so far; it has upper ones too
        later = np.moveaxis(seen, axis, 0)
        later[1:] |= later[:-1].copy()
    return np.flatnonzero(seen)


def nearest_of(chosen: np.ndarray, vertices: int) -> np.ndarray:
    """For each vertex of a [vertices]^3 grid, the place in `chosen` (flat indices) of the nearest chosen vertex."""
    away = np.ones(vertices**3, np.bool_)
    away[chosen] = False
    number = np.zeros(vertices**3, np.int64)
    number[chosen] = np.arange(len(chosen))
    where = distance_transform_edt(away.reshape((vertices,) * 3), return_distances=False, return_indices=True)
    return number[np.ravel_multi_index(tuple(where), (vertices,) * 3).ravel()]
