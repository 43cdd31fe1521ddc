"""The surface of a radiance field that cameras see, as a mesh in scene units."""

from collections.abc import Callable

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.cameras import Camera
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.kernels.cpu.march import OPTICAL_SCALE
from stylerf.surfaces.isosurface import isosurface
from stylerf.surfaces.mesh import Mesh
from stylerf.surfaces.rendered_density import rendered_density, surface_densities
from stylerf.surfaces.visibility import DepthView

# Of the densities at which rays have lost half of their light, from thinnest to densest. Half of a fuzzy surface is
# thinner than the median, which would tear it; the very lowest are those of haze.
LEVEL_QUANTILE = 0.2
DENSEST_LEVEL = 0.9  # opacity of a cell: above it, interpolation between empty and opaque cells is blind
BEHIND = 3.0  # cells that a seen point may lie behind the visible surface


def grid_size(space: SpaceWarp, resolution: int) -> np.ndarray:
    """Return the grid points along each axis [3] of a grid with resolution^3 cells that are about cubes."""
    return space.cells_per_axis(resolution) + 1


def cell_size(space: SpaceWarp, resolution: int) -> float:
    """Return the side of a cell, cube units, mean of the three."""
    return float(np.mean(1 / space.cells_per_axis(resolution)))


def field_surface(
    field: RadianceField,
    cameras: list[Camera],
    resolution: int,
    threads: int,
    on_plane: Callable[[int], None] = lambda done: None,
) -> tuple[Mesh, float]:
    """Return the isosurface of a field's density in scene units, and the opacity of a cell on it.

    The density is taken as the opacity of one grid cell, 1 - exp(-optical depth), which lies in 0..1 and varies evenly
    where densities jump by orders of magnitude. The level is that of the densities at which rays of the cameras have
    lost half of their light: where renders show the surface, whatever the field's scale.

    Raises:
        InvalidValue: no ray of the cameras ends at a surface.
    """
    cell = cell_size(field.space, resolution)
    scale = float(OPTICAL_SCALE) * cell
    densities = surface_densities(field, cameras, threads)
    if not len(densities):
        raise InvalidValue("no ray of the training views ends at a surface: the field is fog throughout")
    level = min(float(-np.expm1(-scale * np.quantile(densities, LEVEL_QUANTILE))), DENSEST_LEVEL)

    def opacity(points: np.ndarray) -> np.ndarray:
        return -np.expm1(-scale * rendered_density(field, points, threads))

    found = isosurface(opacity, grid_size(field.space, resolution), level, on_plane)
    return Mesh(field.space.unwarp(found.vertices), found.faces), level


def seen_part(mesh: Mesh, views: list[DepthView], space: SpaceWarp, tolerance: float) -> Mesh:
    """Return the faces of a mesh in scene units with a vertex that some view sees. tolerance: cube units."""
    seen, normals = np.zeros(len(mesh.vertices), bool), mesh.normals()
    for one in views:
        left = np.flatnonzero(~seen)
        seen[left] = one.facing(mesh.vertices[left], normals[left], space, tolerance) > 0
    return mesh.with_faces(seen[mesh.faces].any(1))


def within_reach(mesh: Mesh, space: SpaceWarp, reach: float) -> Mesh:
    """Return the faces of a mesh in scene units that lie wholly within reach.

    reach: of a contraction, multiples of its inner box; of a frustum, multiples of its near depth. A box has all.
    """
    p = np.array(space.parameters)
    if space.kind == "contraction":
        far = np.abs((mesh.vertices - p[:3]) * p[3:6]).max(1) > reach
    elif space.kind == "frustum":
        far = mesh.vertices[:, 2] > reach * space.near
    else:
        return mesh
    return mesh.with_faces(~far[mesh.faces].any(1))
