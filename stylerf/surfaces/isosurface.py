"""The surface on which a density has one value, by marching cubes in slabs (Lewiner et al. 2003, scikit-image)."""

from collections.abc import Callable

import numpy as np

from stylerf.surfaces.mesh import Mesh

POINTS_AT_ONCE = 1 << 22  # grid points of a slab: its positions take 50 MB
_MATCH = 1e-6  # cells; two slabs interpolate the vertices of their common plane from the same values


def isosurface(
    density: Callable[[np.ndarray], np.ndarray],
    size: np.ndarray,
    level: float,
    on_plane: Callable[[int], None] = lambda done: None,
) -> Mesh:
    """Return the surface in the unit cube where the density is `level`, facing lower densities.

    The grid is evaluated slab by slab, so that memory does not grow with the cube of its resolution.

    Args:
        density: of points [n, 3] float32 in the cube, [n] float32.
        size: [3], grid points along each axis, from face to face of the cube.
        on_plane: called with the number of planes done after each slab.

    Returns:
        The mesh in cube coordinates, without vertices if the density is nowhere as high.
    """
    from skimage.measure import marching_cubes

    depth, height, width = (int(side) for side in size)
    thick = max(2, POINTS_AT_ONCE // (height * width))
    plane = np.stack(np.meshgrid(np.arange(height), np.arange(width), indexing="ij"), -1).reshape(-1, 2)
    vertices: list[np.ndarray] = []
    faces: list[np.ndarray] = []
    count, at = 0, 0
    last: np.ndarray | None = None  # the plane that the next slab begins with
    seam = np.empty((0, 3)), np.empty(0, np.int64)  # vertices on it, and their numbers
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
            faces.append(numbers[triangles[:, ::-1]])  # scikit-image winds them the other way round
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
    """Return [n] for vertices of a slab that begins at plane `at`: their numbers in the slab before, or -1."""
    from scipy.spatial import KDTree

    out = np.full(len(found), -1, np.int64)
    on_first = np.flatnonzero(found[:, 0] < at + _MATCH)
    if len(seam) and len(on_first):
        away, nearest = KDTree(seam).query(found[on_first])
        same = away < _MATCH
        out[on_first[same]] = numbers[nearest[same]]
    return out
