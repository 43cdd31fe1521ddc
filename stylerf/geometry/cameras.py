"""Pinhole cameras, in the convention to which all sources are converted.

Axes are those of OpenCV and COLMAP: x right, y down, z forward. `world_from_camera` maps camera points to world points.
Pixel (column i, row j) has its center at (i + 0.5, j + 0.5); a camera point (x, y, z) projects to
(fx x/z + cx, fy y/z + cy).
"""

from dataclasses import dataclass, replace

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.validation import LARGEST

MIN_FOCAL = 1e-3  # pixels
AXIS_WEIGHT = 0.3  # of differences in viewing direction, relative to position differences as large as the camera spread


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera.

    Attributes:
        width, height: Pixels.
        fx, fy, cx, cy: Pixels.
        world_from_camera: [4, 4] float64, rotation and translation, scene units.
    """

    name: str
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    world_from_camera: np.ndarray  # [4, 4]

    def __post_init__(self) -> None:
        pose = np.asarray(self.world_from_camera, dtype=np.float64)
        if pose.shape != (4, 4) or not np.isfinite(pose).all():
            raise InvalidValue(f"camera {self.name}: pose is not a finite 4x4 matrix")
        rotation = pose[:3, :3]
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-4) or np.linalg.det(rotation) < 0:
            raise InvalidValue(f"camera {self.name}: the upper left 3x3 of its pose is not a rotation")
        if not np.allclose(pose[3], [0, 0, 0, 1], rtol=0, atol=1e-6):
            raise InvalidValue(f"camera {self.name}: the last row of its pose is not 0 0 0 1; is it transposed?")
        if not (self.fx > 0 and self.fy > 0 and np.isfinite([self.fx, self.fy, self.cx, self.cy]).all()):
            raise InvalidValue(f"camera {self.name}: focal length {self.fx:g} x {self.fy:g} is not positive")
        # Rays are float32: beyond these limits their origins or directions would overflow.
        far = max(abs(self.cx), abs(self.cy), self.fx, self.fy, np.abs(pose[:3, 3]).max())
        if far > LARGEST or min(self.fx, self.fy) < MIN_FOCAL:
            raise InvalidValue(
                f"camera {self.name}: its position, focal length or principal point exceeds {LARGEST:g}, or its focal "
                f"length is below {MIN_FOCAL:g} pixels"
            )
        if self.width < 1 or self.height < 1:
            raise InvalidValue(f"camera {self.name}: size {self.width}x{self.height} is empty")
        object.__setattr__(self, "world_from_camera", pose)

    @property
    def center(self) -> np.ndarray:
        """Camera center in world coordinates, [3], scene units."""
        return self.world_from_camera[:3, 3]

    @property
    def forward(self) -> np.ndarray:
        """Unit viewing axis in world coordinates, [3]."""
        return self.world_from_camera[:3, 2]

    @property
    def camera_from_world(self) -> np.ndarray:
        """Inverse of the pose, [4, 4]."""
        return np.linalg.inv(self.world_from_camera)

    def scaled(self, factor: float) -> "Camera":
        """Return the camera of the same view, resized by `factor`; sides are rounded and at least 1."""
        width, height = max(1, round(self.width * factor)), max(1, round(self.height * factor))
        kx, ky = width / self.width, height / self.height
        return replace(
            self, width=width, height=height, fx=self.fx * kx, fy=self.fy * ky, cx=self.cx * kx, cy=self.cy * ky
        )

    def zoomed_out(self, factor: float) -> "Camera":
        """Return the camera with a `factor` times wider field of view (in tangents) and the same number of pixels."""
        return replace(self, fx=self.fx / factor, fy=self.fy / factor)

    def rays(self, pixels: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return the rays through pixel centers.

        Args:
            pixels: Row-major indices [n]; None for all pixels in row-major order. Results are bit-identical.

        Returns:
            Origins and unit directions in world coordinates, [n, 3] float32 each.
        """
        rows, columns = np.divmod(np.arange(self.height * self.width) if pixels is None else pixels, self.width)
        return self.rays_through((columns + 0.5 - self.cx) / self.fx, (rows + 0.5 - self.cy) / self.fy)

    def rays_through(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return origins and unit directions in world coordinates, [n, 3] float32 each, of X/Z and Y/Z [n] float64."""
        length = np.sqrt(x * x + y * y + 1)
        directions = np.empty((len(x), 3), np.float32)
        # Written out, because a matrix product may round differently for a different number of rows.
        for axis, (right, down, forward) in enumerate(self.world_from_camera[:3, :3]):
            directions[:, axis] = (right * x + down * y + forward) / length
        return np.tile(self.center.astype(np.float32), (len(x), 1)), directions

    def ray_cosines(self) -> np.ndarray:
        """Return the cosine of each pixel's ray to the viewing axis, [height, width] float32: Z = distance * cosine."""
        rows, columns = np.meshgrid(np.arange(self.height) + 0.5, np.arange(self.width) + 0.5, indexing="ij")
        x, y = (columns - self.cx) / self.fx, (rows - self.cy) / self.fy
        return (1.0 / np.sqrt(1.0 + x * x + y * y)).astype(np.float32)

    def has_ray(self) -> np.ndarray:
        """Return [height, width] bool: which pixels have a ray; all of them for a pinhole."""
        return np.ones((self.height, self.width), bool)

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Project world points [n, 3] to pixel positions [n, 2] and planar depth [n], <= 0 behind the camera."""
        local = (points - self.center) @ self.world_from_camera[:3, :3]
        depth = local[:, 2]
        safe = np.where(np.abs(depth) < 1e-12, 1e-12, depth)
        pixels = np.stack([self.fx * local[:, 0] / safe + self.cx, self.fy * local[:, 1] / safe + self.cy], axis=-1)
        return pixels, depth

    def unproject(self, pixels: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """Map pixel positions [n, 2] and planar depth [n] to world points [n, 3]."""
        local = np.stack(
            [(pixels[:, 0] - self.cx) / self.fx * depth, (pixels[:, 1] - self.cy) / self.fy * depth, depth], axis=-1
        )
        return local @ self.world_from_camera[:3, :3].T + self.center


# -- matched points (x, y) = (X/Z, Y/Z) in two views -------------------------------------------------------------------


def essential(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the essential matrix E [3, 3] of two poses [4, 4]: x2^T E x1 = 0, with a translation of length 1.

    Zero for cameras at the same position, where every pair of points is consistent.
    """
    second_from_first = np.linalg.inv(second) @ first
    rotation, shift = second_from_first[:3, :3], second_from_first[:3, 3]
    x, y, z = shift / max(np.linalg.norm(shift), 1e-300)
    # E = [t]x R (Longuet-Higgins 1981)
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ rotation


def epipolar_distance(matrix: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the distance of matched points [n, 2] from each other's epipolar lines, the larger one of both views, [n].

    Multiply by the focal length for pixels. 0 if the essential matrix is zero.
    """
    one = np.concatenate([first, np.ones((len(first), 1))], axis=1)
    two = np.concatenate([second, np.ones((len(second), 1))], axis=1)
    in_second, in_first = one @ matrix.T, two @ matrix
    residual = np.abs((two * in_second).sum(axis=1))
    lengths = np.minimum(np.linalg.norm(in_second[:, :2], axis=1), np.linalg.norm(in_first[:, :2], axis=1))
    return np.where(residual > 0, residual / np.maximum(lengths, 1e-12), 0.0)


def largest_parallax(point: np.ndarray, centers: np.ndarray) -> float:
    """Return the largest angle, in degrees, between two rays from camera centers [n, 3] to a point [3]."""
    rays = point - centers
    rays = rays / np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-300)
    return float(np.degrees(np.arccos(np.clip((rays @ rays.T).min(), -1, 1))))


def evenly_spaced(count: int, most: int) -> list[int]:
    """Return the indices of up to `most` of `count` views, evenly spaced from the first to the last."""
    return [int(view) for view in np.unique(np.linspace(0, count - 1, min(count, most)).round())]


def from_far_apart(cameras: list[Camera]) -> list[int]:
    """Return an order of cameras in which each is the farthest from all before it (farthest-point sampling)."""
    if not cameras:
        return []
    centers = np.array([camera.center for camera in cameras])
    size = max(float(np.linalg.norm(np.ptp(centers, axis=0))), 1e-9)
    places = np.concatenate([centers / size, AXIS_WEIGHT * np.array([camera.forward for camera in cameras])], 1)
    order = [int(np.argmin(np.linalg.norm(places - places.mean(0), axis=1)))]
    distances = np.linalg.norm(places - places[order[0]], axis=1)
    while len(order) < len(cameras):
        distances[order[-1]] = -1
        order.append(int(np.argmax(distances)))
        distances = np.minimum(distances, np.linalg.norm(places - places[order[-1]], axis=1))
    return order
