"""Rays of a camera, against its own projection; matched points of two, against points that are known in space."""

from dataclasses import replace

import numpy as np
import pytest

from stylerf.geometry.camera_paths import look_at
from stylerf.geometry.cameras import Camera, epipolar_distance, essential, from_far_apart, largest_parallax
from tests.stylerf.geometry.test_camera_conventions import random_rotation

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


def test_zoomed_out_sees_farther_to_each_side():
    points = CAMERA.center + 3.0 * CAMERA.rays()[1]
    near, far = CAMERA.project(points)[0], CAMERA.zoomed_out(1.5).project(points)[0]
    np.testing.assert_allclose(far - [CAMERA.cx, CAMERA.cy], (near - [CAMERA.cx, CAMERA.cy]) / 1.5, atol=1e-4)


def test_cameras_from_far_apart_begin_in_the_middle_and_go_to_the_ends():
    def at(x: float) -> Camera:
        pose = look_at(np.array([x, -3.0, 0]), np.array([x, 0, 0]), np.array([0, 0, 1.0]))
        return replace(CAMERA, world_from_camera=pose)

    line = [at(x) for x in (0.0, 1.0, 3.5, 6.5, 5.3)]
    assert from_far_apart(line) == [2, 0, 3, 4, 1]
    assert sorted(from_far_apart([at(1.0)] * 3)) == [0, 1, 2] and from_far_apart([]) == []


@pytest.mark.parametrize("chosen", [[0], [390, 0, 5, 5], list(range(7, 390, 3))])
def test_rays_of_some_pixels_are_the_same_to_the_bit(chosen):
    every, some = CAMERA.rays(), CAMERA.rays(np.array(chosen))
    for whole, part in zip(every, some):
        assert np.array_equal(whole[chosen], part)


def pose(seed: int, center) -> np.ndarray:
    """A camera that looks roughly along z."""
    matrix = np.eye(4)
    near_one, signs = np.linalg.qr(np.eye(3) + 0.2 * random_rotation(seed))
    matrix[:3, :3], matrix[:3, 3] = near_one * np.sign(np.diag(signs)), center
    return matrix


def seen(points, world_from_camera):
    local = (points - world_from_camera[:3, 3]) @ world_from_camera[:3, :3]
    return local[:, :2] / local[:, 2:]


def test_matches_of_true_points_lie_on_their_epipolar_lines():
    points = np.random.default_rng(0).uniform(-1, 1, (50, 3)) + [0, 0, 5]
    first, second = pose(1, [0, 0, 0]), pose(2, [0.8, 0.1, -0.2])
    matrix = essential(first, second)
    assert epipolar_distance(matrix, seen(points, first), seen(points, second)).max() < 1e-12
    assert epipolar_distance(np.zeros((3, 3)), seen(points, first), seen(points, second)).max() == 0


def test_a_match_moved_off_its_line_is_so_far_from_it():
    """Cameras side by side: epipolar lines are rows, so the distance is the difference in y."""
    first, second = np.eye(4), np.eye(4)
    second[0, 3] = 1.0
    one = np.array([[0.1, 0.2], [-0.3, 0.05]])
    two = one + [[-0.2, 0.03], [-0.1, -0.07]]
    np.testing.assert_allclose(epipolar_distance(essential(first, second), one, two), [0.03, 0.07], atol=1e-12)


def test_parallax_is_the_widest_angle():
    centers = np.array([[1.0, 0, 0], [0, 0, 1.0], [np.sqrt(0.5), 0, np.sqrt(0.5)]])
    assert abs(largest_parallax(np.zeros(3), centers) - 90) < 1e-9
    assert largest_parallax(np.zeros(3), centers[:1]) < 1e-5
