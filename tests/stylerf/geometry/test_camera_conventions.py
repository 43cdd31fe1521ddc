"""Conventions: the same point falls on the same pixel by each source's own formula and by our Camera."""

import numpy as np
import pycolmap
import pytest

from stylerf.errors import InvalidValue
from stylerf.geometry import camera_conventions
from stylerf.geometry.cameras import Camera

WIDTH, HEIGHT, FOCAL = 64, 48, 50.0
POINTS = np.random.default_rng(1).normal(size=(20, 3)) * 0.4


def random_rotation(seed: int) -> np.ndarray:
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else q[:, [1, 0, 2]]


def pixels_of(pose: np.ndarray, points: np.ndarray = POINTS) -> np.ndarray:
    camera = Camera("c", WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, pose)
    pixels, depth = camera.project(points)
    assert (depth > 0).all()
    return pixels


@pytest.mark.parametrize("seed", range(4))
def test_opengl_cameras_look_along_minus_z_with_y_up(seed):
    rotation = random_rotation(seed)
    center = rotation @ [0.2, -0.1, 4.0]  # the origin lies in front, along the camera's -z
    local = (POINTS - center) @ rotation  # Blender's camera coordinates: x right, y up, z backward
    expected = np.stack(
        [WIDTH / 2 + FOCAL * local[:, 0] / -local[:, 2], HEIGHT / 2 - FOCAL * local[:, 1] / -local[:, 2]], axis=1
    )
    pose = np.vstack([np.column_stack([rotation, center]), [0, 0, 0, 1]])
    np.testing.assert_allclose(pixels_of(camera_conventions.from_opengl(pose)), expected, atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_llff_columns_are_down_right_backward(seed):
    rotation = random_rotation(seed)
    down, right, backward = rotation.T
    if np.linalg.det(np.column_stack([right, -down, backward])) < 0:
        down = -down
    center = 4.0 * backward
    seen = POINTS - center
    depth = seen @ -backward
    expected = np.stack([WIDTH / 2 + FOCAL * seen @ right / depth, HEIGHT / 2 + FOCAL * seen @ down / depth], axis=1)
    pose = np.column_stack([down, right, backward, center, [HEIGHT, WIDTH, FOCAL]])
    np.testing.assert_allclose(pixels_of(camera_conventions.from_llff(pose)), expected, atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_colmap_tells_camera_from_world(seed):
    rotation, shift = random_rotation(seed), np.array([0.1, 0.2, 4.0])
    camera = pycolmap.Camera(model="SIMPLE_PINHOLE", width=WIDTH, height=HEIGHT, params=[FOCAL, WIDTH / 2, HEIGHT / 2])
    there = pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), shift)
    expected = np.array([camera.img_from_cam(there * point) for point in POINTS]).reshape(-1, 2)
    pose = camera_conventions.from_colmap(np.column_stack([rotation, shift]))
    np.testing.assert_allclose(pixels_of(pose), expected, atol=1e-9)


def test_a_rotation_with_rounding_is_made_exact_and_others_are_refused():
    rotation = random_rotation(5)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.round(rotation, 4), [1, 2, 3]
    exact = camera_conventions.checked_pose(pose)
    np.testing.assert_allclose(exact[:3, :3] @ exact[:3, :3].T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(exact, pose, atol=2e-4)
    for fault, word in ((np.diag([1, 1, -1.0]), "mirrored"), (1.01 * np.eye(3), "not a rotation")):
        broken = pose.copy()
        broken[:3, :3] = rotation @ fault
        with pytest.raises(InvalidValue, match=word):
            camera_conventions.checked_pose(broken)
    pose[0, 3] = np.nan
    with pytest.raises(InvalidValue, match="NaN"):
        camera_conventions.checked_pose(pose)
    with pytest.raises(InvalidValue, match="4x4"):
        camera_conventions.checked_pose(np.eye(3))
