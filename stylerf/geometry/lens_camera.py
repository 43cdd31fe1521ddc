"""Cameras with lens distortion, whose rays are those of the original photo's pixels."""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from stylerf.geometry.cameras import Camera
from stylerf.geometry.distortion import BAND_ROWS, Distortion, Intrinsics


@dataclass(frozen=True, eq=False)
class LensCamera(Camera):
    """A camera with distortion: fx, fy, cx, cy map distorted points to pixels. project and unproject ignore it."""

    distortion: Distortion = Distortion()  # noqa: RUF009, frozen

    def rays(self, pixels: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """See Camera.rays. Pixels to which the lens model maps no direction get the viewing axis."""
        points = np.nan_to_num(self.points().reshape(-1, 2)[slice(None) if pixels is None else pixels], nan=0.0)
        return self.rays_through(points[:, 0].astype(np.float64), points[:, 1].astype(np.float64))

    def ray_cosines(self) -> np.ndarray:
        """See Camera.ray_cosines."""
        points = np.nan_to_num(self.points(), nan=0.0)
        return (1.0 / np.sqrt(1.0 + np.square(points).sum(axis=-1))).astype(np.float32)

    def has_ray(self) -> np.ndarray:
        """Return [height, width] bool: false where the lens model maps no direction to a pixel."""
        return np.isfinite(self.points()).all(axis=-1)

    def points(self) -> np.ndarray:
        """Return (X/Z, Y/Z) of each pixel, [height, width, 2] float32; NaN without a ray."""
        intrinsics = (self.fx, self.fy, self.cx, self.cy)
        return undistorted_points((self.width, self.height), intrinsics, self.distortion)


@lru_cache(maxsize=1)  # most views of a capture share a lens, and Newton's method takes a second per megapixel
def undistorted_points(size: tuple[int, int], intrinsics: Intrinsics, distortion: Distortion) -> np.ndarray:
    """Return (X/Z, Y/Z) of each pixel center of a distorted image, [height, width, 2] float32; NaN without a ray."""
    (width, height), (fx, fy, cx, cy) = size, intrinsics
    points = np.empty((height, width, 2), np.float32)
    columns = (np.arange(width) + 0.5 - cx) / fx
    for top in range(0, height, BAND_ROWS):
        rows = (np.arange(top, min(top + BAND_ROWS, height)) + 0.5 - cy) / fy
        distorted = np.stack(np.meshgrid(columns, rows), axis=-1)
        with np.errstate(over="ignore", invalid="ignore"):  # Newton's method may diverge to NaN
            points[top : top + BAND_ROWS] = distorted if distortion.none else distortion.undistort(distorted)
    points.flags.writeable = False
    return points


def through_lens(camera: Camera, size: tuple[int, int], intrinsics: Intrinsics, distortion: Distortion) -> LensCamera:
    """Return the camera of the distorted photo (width, height) from which an undistorted `camera` was made."""
    fx, fy, cx, cy = intrinsics
    return LensCamera(camera.name, *size, fx, fy, cx, cy, camera.world_from_camera, distortion)


def at_size(camera: Camera, size: tuple[int, int]) -> Camera:
    """Return the camera of the same view at another size (width, height), possibly with a different aspect ratio."""
    kx, ky = size[0] / camera.width, size[1] / camera.height
    return replace(
        camera, width=size[0], height=size[1], fx=camera.fx * kx, fy=camera.fy * ky, cx=camera.cx * kx,
        cy=camera.cy * ky,
    )  # fmt: skip
