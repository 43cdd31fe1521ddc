"""Rays of a camera, against its own projection."""

import numpy as np
import pytest

from stylerf.geometry.camera_paths import look_at
from stylerf.geometry.cameras import Camera

POSE = look_at(np.array([1.7, -2.0, 0.9]), np.array([0.1, 0.2, 0.0]), np.array([0, 0, 1.0]))
CAMERA = Camera("one", 23, 17, 21.0, 24.0, 10.3, 9.1, POSE)


def test_every_ray_leaves_the_center_through_its_pixels_center():
    origins, directions = CAMERA.rays()
    assert origins.dtype == directions.dtype == np.float32 and origins.shape == directions.shape == (17 * 23, 3)
    np.testing.assert_allclose(origins, np.broadcast_to(CAMERA.center, origins.shape), atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, atol=1e-6)
    pixels, depth = CAMERA.project(CAMERA.center + 5.0 * directions)
    rows, columns = np.divmod(np.arange(17 * 23), 23)
    np.testing.assert_allclose(pixels, np.stack([columns + 0.5, rows + 0.5], 1), atol=1e-4)
    assert (depth > 0).all()


@pytest.mark.parametrize("chosen", [[0], [390, 0, 5, 5], list(range(7, 390, 3))])
def test_rays_of_some_pixels_are_the_same_to_the_bit(chosen):
    every, some = CAMERA.rays(), CAMERA.rays(np.array(chosen))
    for whole, part in zip(every, some):
        assert np.array_equal(whole[chosen], part)
