"""ST maps between a photo with lens distortion (the plate) and its undistorted image.

For each pixel of the output image, a map holds the position in the input image that its color comes from: u = x / width
and v = 1 - y / height for a position (x, y) in pixels from the top left corner, so (0, 0) is the bottom left corner and
the center of the first pixel in the last row is (0.5 / width, 0.5 / height).
"""

import numpy as np

from stylerf.geometry.cameras import Camera
from stylerf.geometry.distortion import source_positions
from stylerf.geometry.lens_camera import LensCamera

NOWHERE = -1.0  # outside any image


def undistort_map(plate: LensCamera, pinhole: Camera) -> np.ndarray:
    """Return the map from the plate to the pinhole image: [h, w, 2] float32, of the pinhole's size."""
    positions = source_positions(
        (pinhole.width, pinhole.height),
        (pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy),
        (plate.fx, plate.fy, plate.cx, plate.cy),
        plate.distortion,
    )
    return _normalized(positions, plate)


def redistort_map(plate: LensCamera, pinhole: Camera) -> np.ndarray:
    """Return the map from the pinhole image to the plate: [h, w, 2] float32, of the plate's size.

    The pinhole shows a rectangle of the plate: near the plate's border, values are outside 0..1, and NOWHERE where the
    lens model maps no direction to a pixel.
    """
    scale, center = np.array([[pinhole.fx, pinhole.fy], [pinhole.cx, pinhole.cy]], np.float32)
    positions = plate.points() * scale + center
    return _normalized(positions, pinhole)


def _normalized(positions: np.ndarray, camera: Camera) -> np.ndarray:
    scale, origin = np.array([[1 / camera.width, -1 / camera.height], [0, 1]], np.float32)
    mapped = positions * scale + origin
    return np.where(np.isfinite(mapped).all(axis=-1, keepdims=True), mapped, np.float32(NOWHERE))
