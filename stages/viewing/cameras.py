"""Cameras of the page: from a pose and a vertical field of view to a pinhole camera with a given number of pixels."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from stylerf.geometry.cameras import Camera

FEWEST_PIXELS = 32 * 24
LONGEST_ASPECT = 8.0
STEEP = 0.1  # sine of the angle between the view and the vertical under which the picture's own up is taken


@dataclass(frozen=True)
class Pose:
    """Where the page's camera is.

    Attributes:
        quaternion: w x y z of world_from_camera; x right, y down, z forward.
        position: Scene units.
        fov: Vertical field of view, radians.
        aspect: Width over height.
    """

    quaternion: tuple[float, float, float, float]
    position: tuple[float, float, float]
    fov: float
    aspect: float

    @staticmethod
    def of(camera: Camera, aspect: float) -> "Pose":
        """Return the pose that sees at least what a camera sees, around its image's center."""
        x, y, z, w = Rotation.from_matrix(camera.world_from_camera[:3, :3]).as_quat().tolist()
        tangent = camera.height / 2 / camera.fy
        across = camera.width / 2 / camera.fx
        fov = 2 * math.atan(max(tangent, across / aspect))
        px, py, pz = camera.center.tolist()
        return Pose((w, x, y, z), (px, py, pz), fov, aspect)

    @property
    def matrix(self) -> np.ndarray:
        """world_from_camera [4, 4]."""
        w, x, y, z = self.quaternion
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_quat([x, y, z, w]).as_matrix()
        pose[:3, 3] = self.position
        return pose

    def sound(self) -> bool:
        """Return whether the numbers that a page sent are valid for a camera."""
        numbers = (*self.quaternion, *self.position, self.fov, self.aspect)
        turned = float(np.linalg.norm(self.quaternion)) if np.isfinite(numbers).all() else 0.0
        return 0.5 < turned < 2 and 0.01 < self.fov < 3.1 and 1 / LONGEST_ASPECT < self.aspect < LONGEST_ASPECT

    def camera(self, pixels: float, name: str = "view") -> Camera:
        """Return the camera of about this many pixels, at least FEWEST_PIXELS."""
        height = max(1, round(math.sqrt(max(pixels, FEWEST_PIXELS) / self.aspect)))
        width = max(1, round(height * self.aspect))
        focal = height / 2 / math.tan(self.fov / 2)
        return Camera(name, width, height, focal, focal, width / 2, height / 2, self.matrix)


def pixel_at(camera: Camera, across: float, down: float) -> int:
    """Return the row-major pixel at a position in 0..1 from the top left, clamped to the picture."""
    x = min(int(np.clip(across, 0, 1) * camera.width), camera.width - 1)
    y = min(int(np.clip(down, 0, 1) * camera.height), camera.height - 1)
    return y * camera.width + x


def level_up(up: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Return the direction nearest to `up` that a camera can use as up without rolling; drags turn the camera around
    it.

    That is `up` without its part along the camera's right: the vertical itself, if the horizon is level in the picture.

    Args:
        up: the scene's, unit [3].
        pose: world_from_camera [4, 4].
    """
    right, above, forward = pose[:3, 0], -pose[:3, 1], pose[:3, 2]
    level = up - (up @ right) * right
    if level @ above <= 0 or np.linalg.norm(np.cross(level, forward)) < STEEP:
        return above
    return np.asarray(level / np.linalg.norm(level))
