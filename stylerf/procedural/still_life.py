"""A still life with known ground truth: fruit, vase, book, cube, ring, ball and candle on a round wooden table.

Rendered by sphere tracing of signed distance functions. Nothing varies randomly between views: shadows and occlusion
are closed-form estimates, so a point has the same diffuse color from everywhere.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.geometry.camera_paths import look_at
from stylerf.geometry.cameras import Camera
from stylerf.procedural.shading import shade_rows
from stylerf.procedural.solids import Solid, arrangement, pack
from stylerf.procedural.tracing import MISS, point_distances, trace_rays

TRACE_TOLERANCE = 1e-6  # scene units
EXPOSURE = 0.54


@dataclass(frozen=True, eq=False)
class TrueView:
    """A rendered view with ground truth.

    rgba: [h, w, 4] float32, straight alpha: sRGB-encoded color 0..1 and coverage 0..1, box-filtered.
    ray_distance, z: [h, w] float32, at pixel centers, unfiltered, scene units; inf where the center's ray misses.
    """

    rgba: np.ndarray
    ray_distance: np.ndarray
    z: np.ndarray


class StillLife:
    """The analytic scene: distances, hits and images. z is up; everything is within [-1.25, 1.25]^3.

    seed: of the textures (grain, mottling). solids: None for the still life's own, whose arrangement is fixed.
    """

    def __init__(self, seed: int = 0, solids: list[Solid] | None = None) -> None:
        self.seed = seed
        self.solids = arrangement() if solids is None else solids
        self._packed = pack(self.solids)

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Return a lower bound [n] float64 on the signed distance of points [n, 3]: 0 on the surface, < 0 inside."""
        return point_distances(self._packed, np.ascontiguousarray(points, np.float64))

    def trace(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Return the distance [n] float64 to the first surface along rays [n, 3], of any length; inf on a miss."""
        return self.trace_owners(origins, directions)[0]

    def trace_owners(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Trace rays as trace() does, and also return the index [n] into `solids`; -1 on a miss."""
        directions = np.array(directions, np.float64)
        lengths = np.linalg.norm(directions, axis=-1, keepdims=True)
        if not (lengths > 0).all():
            raise InvalidValue("a ray has no direction")
        origins = np.ascontiguousarray(np.broadcast_to(np.asarray(origins, np.float64), directions.shape))
        distances, owners = trace_rays(self._packed, origins, directions / lengths, TRACE_TOLERANCE)
        return np.where(owners < 0, np.inf, np.minimum(distances, MISS)), owners

    def render(self, camera: Camera, samples: int = 2, edge_samples: int = 4, threads: int = 1) -> TrueView:
        """Render a camera's view. Each pixel is the mean of samples^2 rays, or edge_samples^2 where those differ."""
        out = np.empty((camera.height, camera.width, 4), np.float32)
        lens = (float(camera.fx), float(camera.fy), float(camera.cx), float(camera.cy))
        pose = np.ascontiguousarray(camera.world_from_camera)

        def shade(rows: np.ndarray) -> None:
            first, last = int(rows[0]), int(rows[-1]) + 1
            shade_rows(self._packed, self.seed, EXPOSURE, lens, pose, first, out[first:last], samples, edge_samples)

        bands = [rows for rows in np.array_split(np.arange(camera.height), 8 * threads) if len(rows)]
        if threads > 1:
            with ThreadPoolExecutor(threads) as pool:
                list(pool.map(shade, bands))
        else:
            shade(np.arange(camera.height))
        distance = self.center_distances(camera)
        return TrueView(out, distance.astype(np.float32), (distance * camera.ray_cosines()).astype(np.float32))

    def center_distances(self, camera: Camera) -> np.ndarray:
        """Return the ray distance [h, w] float64 at pixel centers, from float64 rays; inf on a miss."""
        rows, columns = np.meshgrid(np.arange(camera.height) + 0.5, np.arange(camera.width) + 0.5, indexing="ij")
        pixels = np.stack([columns.ravel(), rows.ravel()], axis=-1)
        directions = camera.unproject(pixels, np.ones(len(pixels))) - camera.center
        return self.trace(camera.center[None], directions).reshape(camera.height, camera.width)


def dome_cameras(
    count: int,
    size: int,
    prefix: str,
    seed: int,
    radius: float = 4.03,
    angle_x: float = 0.6911112,
    elevations_deg: tuple[float, float] = (10.0, 72.0),
) -> list[Camera]:
    """Return `count` cameras evenly spread over a dome about the origin, all facing it.

    size: pixels, square images; radius: scene units; angle_x: horizontal field of view, radians (NeRF-synthetic's).
    A golden-angle spiral with equal area between the elevations, rotated and jittered by the seed.
    """
    random = np.random.default_rng(seed)
    low, high = np.sin(np.radians(elevations_deg))
    order = (np.arange(count) + random.uniform(0.25, 0.75, count)) / max(count, 1)
    heights = low + (high - low) * order
    turns = np.arange(count) * np.pi * (3.0 - np.sqrt(5.0)) + random.uniform(0, 2 * np.pi)
    flat = np.sqrt(1.0 - heights**2)
    eyes = radius * np.stack([flat * np.cos(turns), flat * np.sin(turns), heights], axis=-1)
    focal = 0.5 * size / np.tan(0.5 * angle_x)
    poses = [look_at(eye, np.zeros(3), np.array([0.0, 0.0, 1.0])) for eye in eyes]
    lens = size, size, focal, focal, size / 2, size / 2
    return [Camera(f"{prefix}_{i:03d}", *lens, pose) for i, pose in enumerate(poses)]
