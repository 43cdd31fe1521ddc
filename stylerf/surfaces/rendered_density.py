"""The density that rays of a field meet, on any points, and the level at which cameras see a surface in it."""

import numpy as np

from stylerf.fields.marching import SAMPLES_PER_RAY
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.cameras import Camera
from stylerf.kernels.cpu.ray_samples import Rays

RAYS_PER_VIEW = 2048
MIN_ALPHA = 0.9  # of rays that end at a surface
HALF = 0.5


def rendered_density(field: RadianceField, points: np.ndarray, threads: int) -> np.ndarray:
    """Return raw density [n] at points [n, 3] of the cube as rays meet it: displaced, and 0 in unoccupied cells."""
    cells = field.occupancy.cells
    index = np.minimum((points * cells).astype(np.int64), cells - 1)
    flat = (index[:, 0] * cells + index[:, 1]) * cells + index[:, 2]
    near = np.flatnonzero(field.occupancy.distances[flat] == 0)
    out = np.zeros(len(points), np.float32)
    if len(near):
        out[near] = field.density.sigma(np.ascontiguousarray(displaced(field, points[near])), threads)
    return out


def displaced(field: RadianceField, points: np.ndarray) -> np.ndarray:
    """Return points [n, 3] of the cube, float32, where a field's displacement takes them."""
    grid = field.displacement
    if grid is None:
        return points
    from scipy.ndimage import map_coordinates

    places = (points * (np.array(grid.shape[:3]) - 1)).T  # vertices span the cube, ends included
    shift = np.stack([map_coordinates(grid[..., axis], places, order=1, mode="nearest") for axis in range(3)], -1)
    return np.clip(points + shift, 0, 1).astype(np.float32)


def surface_densities(field: RadianceField, cameras: list[Camera], threads: int) -> np.ndarray:
    """Return raw densities [n] where rays of the cameras have lost half of their light, at optical depth ln 2.

    Rays are those that end at a surface: alpha at least MIN_ALPHA, not counting an opaque background.
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
