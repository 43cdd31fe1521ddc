"""The surface of a radiance field that cameras see, as a mesh in scene units."""

from collections.abc import Callable

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.fields.marching import SAMPLES_PER_RAY
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.cameras import Camera
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.kernels.cpu.march import OPTICAL_SCALE
from stylerf.kernels.cpu.ray_samples import Rays
from stylerf.surfaces.mesh import Mesh
from stylerf.surfaces.visibility import DepthView

# Quantile of the densities at which rays have lost half of their light. Half of a fuzzy surface is thinner than the
# median, which would tear it apart; the lowest values are haze.
LEVEL_QUANTILE = 0.2
DENSEST_LEVEL = 0.9  # opacity of a cell above which interpolation between empty and opaque cells is inaccurate
BEHIND = 3.0  # cells that a visible point may be behind the visible surface
RAYS_PER_VIEW = 2048
MIN_ALPHA = 0.9  # of rays that end at a surface
HALF = 0.5
POINTS_AT_ONCE = 1 << 22  # grid points of a slab: its positions take 50 MB
_MATCH = 1e-6  # cells; two slabs interpolate the vertices of their common plane from the same values


def grid_size(space: SpaceWarp, resolution: int) -> np.ndarray:
    """Return the number of grid points along each axis, [3], for resolution^3 approximately cubic cells."""
    return space.cells_per_axis(resolution) + 1


def cell_size(space: SpaceWarp, resolution: int) -> float:
    """Return the mean side of a cell, cube units."""
    return float(np.mean(1 / space.cells_per_axis(resolution)))


def field_surface(
    field: RadianceField,
    cameras: list[Camera],
    resolution: int,
    threads: int,
    on_plane: Callable[[int], None] = lambda done: None,
) -> tuple[Mesh, float]:
    """Return the isosurface of a field's density in scene units, and the opacity of a cell on it.

    Density is expressed as the opacity of one grid cell, 1 - exp(-optical depth), which is in 0..1 and varies smoothly
    where densities change by orders of magnitude. The level is chosen from the densities at which the cameras' rays
    have lost half of their light: where renders show the surface, at any scale of the field.

    Raises:
        InvalidValue: no camera ray ends at a surface.
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
    """Return a mesh, in scene units, reduced to faces with a vertex that some view sees. tolerance: cube units."""
    seen, normals = np.zeros(len(mesh.vertices), bool), mesh.normals()
    for one in views:
        left = np.flatnonzero(~seen)
        seen[left] = one.facing(mesh.vertices[left], normals[left], space, tolerance) > 0
    return mesh.with_faces(seen[mesh.faces].any(1))


def within_reach(mesh: Mesh, space: SpaceWarp, reach: float) -> Mesh:
    """Return a mesh, in scene units, reduced to faces that are entirely within reach.

    reach: multiples of the inner box for a contraction, of the near depth for a frustum. In a box, all faces are kept.
    """
    p = np.array(space.parameters)
    if space.kind == "contraction":
        far = np.abs((mesh.vertices - p[:3]) * p[3:6]).max(1) > reach
    elif space.kind == "frustum":
        far = mesh.vertices[:, 2] > reach * space.near
    else:
        return mesh
    return mesh.with_faces(~far[mesh.faces].any(1))


def rendered_density(field: RadianceField, points: np.ndarray, threads: int) -> np.ndarray:
    """Return raw density [n] at cube points [n, 3] as rays see it: displaced, and 0 in unoccupied cells."""
    cells = field.occupancy.cells
    index = np.minimum((points * cells).astype(np.int64), cells - 1)
    flat = (index[:, 0] * cells + index[:, 1]) * cells + index[:, 2]
    near = np.flatnonzero(field.occupancy.distances[flat] == 0)
    out = np.zeros(len(points), np.float32)
    if len(near):
        out[near] = field.density.sigma(np.ascontiguousarray(displaced(field, points[near])), threads)
    return out


def displaced(field: RadianceField, points: np.ndarray) -> np.ndarray:
    """Return cube points [n, 3], float32, after a field's displacement."""
    grid = field.displacement
    if grid is None:
        return points
    from scipy.ndimage import map_coordinates

    places = (points * (np.array(grid.shape[:3]) - 1)).T  # vertices span the cube, ends included
    shift = np.stack([map_coordinates(grid[..., axis], places, order=1, mode="nearest") for axis in range(3)], -1)
    return np.clip(points + shift, 0, 1).astype(np.float32)


def surface_densities(field: RadianceField, cameras: list[Camera], threads: int) -> np.ndarray:
    """Return raw densities [n] where the cameras' rays have lost half of their light, at optical depth ln 2.

    Only rays that end at a surface count: alpha at least MIN_ALPHA, not counting an opaque background.
    """
    found = []
    for camera in cameras:
        count = camera.width * camera.height
        pixels = np.unique(np.linspace(0, count - 1, min(RAYS_PER_VIEW, count)).astype(np.int64))
        samples = field.march(Rays.of(*camera.rays(pixels), field.space.near), SAMPLES_PER_RAY, 1e-3, threads)
        for start, end in zip(samples.starts, samples.ends, strict=True):
            solid = samples.deltas[start:end] > 0
            weights = np.cumsum(samples.weights[start:end] * solid)
            if len(weights) and weights[-1] >= MIN_ALPHA:
                found.append(samples.sigma[start + int(np.searchsorted(weights, HALF))])
    return np.array(found, np.float32)


def isosurface(
    density: Callable[[np.ndarray], np.ndarray],
    size: np.ndarray,
    level: float,
    on_plane: Callable[[int], None] = lambda done: None,
) -> Mesh:
    """Return the surface in the unit cube where the density is `level`, facing lower densities (Lewiner et al. 2003).

    The grid is evaluated slab by slab, so that memory does not grow with the cube of its resolution.

    Args:
        density: maps points [n, 3] float32 in the cube to [n] float32.
        size: [3], grid points along each axis, from face to face of the cube.
        on_plane: called after each slab with the number of planes done.

    Returns:
        The mesh in cube coordinates, without vertices if the density never reaches the level.
    """
    from skimage.measure import marching_cubes

    depth, height, width = (int(side) for side in size)
    thick = max(2, POINTS_AT_ONCE // (height * width))
    plane = np.stack(np.meshgrid(np.arange(height), np.arange(width), indexing="ij"), -1).reshape(-1, 2)
    vertices: list[np.ndarray] = []
    faces: list[np.ndarray] = []
    count, at = 0, 0
    last: np.ndarray | None = None  # the plane with which the next slab begins
    seam = np.empty((0, 3)), np.empty(0, np.int64)  # its vertices, and their indices
    while at < depth - 1:
        end = min(at + thick, depth)
        slab = np.empty((end - at, height, width), np.float32)
        for index in range(end - at):
            if index == 0 and last is not None:
                slab[0] = last
            else:
                x = np.full((len(plane), 1), at + index)
                points = np.concatenate([x, plane], axis=1) / (np.asarray(size) - 1)
                slab[index] = density(points.astype(np.float32)).reshape(height, width)
        last = slab[-1].copy()
        if slab.min() < level < slab.max():
            found, triangles, _, _ = marching_cubes(slab, level)
            found = found.astype(np.float64) + [at, 0, 0]
            numbers = np.arange(count, count + len(found))
            joined = _joined(found, at, *seam)
            numbers[joined >= 0] = joined[joined >= 0]
            fresh = joined < 0
            numbers[fresh] = count + np.arange(fresh.sum())
            vertices.append(found[fresh])
            faces.append(numbers[triangles[:, ::-1]])  # scikit-image uses the opposite winding
            count += int(fresh.sum())
            on_last = found[:, 0] > end - 1 - _MATCH
            seam = found[on_last], numbers[on_last]
        else:
            seam = np.empty((0, 3)), np.empty(0, np.int64)
        at = end - 1
        on_plane(end)
    if not vertices:
        return Mesh(np.empty((0, 3)), np.empty((0, 3), np.int64))
    return Mesh(np.concatenate(vertices) / (np.asarray(size) - 1), np.concatenate(faces).astype(np.int64))


def _joined(found: np.ndarray, at: int, seam: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """Return, for vertices [n] of a slab that begins at plane `at`, their indices in the previous slab, or -1."""
    from scipy.spatial import KDTree

    out = np.full(len(found), -1, np.int64)
    on_first = np.flatnonzero(found[:, 0] < at + _MATCH)
    if len(seam) and len(on_first):
        away, nearest = KDTree(seam).query(found[on_first])
        same = away < _MATCH
        out[on_first[same]] = numbers[nearest[same]]
    return out
