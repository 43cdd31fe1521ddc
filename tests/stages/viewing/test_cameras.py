"""The page's camera as the renderer's."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stages.viewing.cameras import Pose, level_up, pixel_at
from tests.stages.photo_room import walk


def test_a_pose_of_a_camera_sees_what_the_camera_sees():
    for camera in walk(3):
        made = Pose.of(camera, camera.width / camera.height).camera(camera.width * camera.height)
        assert (made.width, made.height) == (camera.width, camera.height)
        np.testing.assert_allclose(made.world_from_camera, camera.world_from_camera, atol=1e-9)
        np.testing.assert_allclose([made.fx, made.fy], [camera.fx, camera.fy], rtol=1e-9)


@pytest.mark.parametrize("aspect", [0.5, 1.0, 2.0])
def test_number_of_pixels_and_aspect_are_kept(aspect):
    camera = Pose((1, 0, 0, 0), (0, 0, 0), 0.9, aspect).camera(20_000)
    assert camera.width * camera.height == pytest.approx(20_000, rel=0.02)
    assert camera.width / camera.height == pytest.approx(aspect, rel=0.02)


def test_numbers_that_no_camera_has_are_refused():
    sound = Pose((1, 0, 0, 0), (0, 0, 0), 0.9, 1.3)
    assert sound.sound()
    for bad in (
        Pose((0, 0, 0, 0), (0, 0, 0), 0.9, 1.3), Pose((1, 0, 0, 0), (float("nan"), 0, 0), 0.9, 1.3),
        Pose((1, 0, 0, 0), (0, 0, 0), 0.0, 1.3), Pose((1, 0, 0, 0), (0, 0, 0), 0.9, float("inf")),
    ):  # fmt: skip
        assert not bad.sound()


def test_places_outside_count_as_the_rim():
    camera = Pose((1, 0, 0, 0), (0, 0, 0), 0.9, 1.0).camera(10_000)
    assert pixel_at(camera, -1, -1) == 0 and pixel_at(camera, 2, 2) == camera.width * camera.height - 1
    assert pixel_at(camera, 0.5, 0.0) == camera.width // 2


@pytest.mark.parametrize(("pitch", "roll"), [(20, 0), (-50, 0), (20, 8), (0, 30)])
def test_turning_around_the_level_up_keeps_the_picture_and_the_horizon(pitch, roll):
    """Looking along x, z up; Rodrigues: a turn around an axis keeps each vector's part along it."""
    level = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # columns: right, down, forward
    pose = np.eye(4)
    pose[:3, :3] = level @ Rotation.from_euler("xz", [pitch, roll], degrees=True).as_matrix()
    up = level_up(np.array([0.0, 0.0, 1.0]), pose)
    right, above = pose[:3, 0], -pose[:3, 1]
    assert np.linalg.norm(up) == pytest.approx(1) and up @ above > 0
    assert up @ right == pytest.approx(0, abs=1e-12), "the picture does not roll"
    if roll == 0:
        np.testing.assert_allclose(up, [0, 0, 1], atol=1e-12)
    assert up[2] >= above[2] - 1e-12, "no farther from the vertical than the picture's own"


def test_a_camera_that_looks_down_or_stands_on_its_head_has_its_own_up():
    for angle in (90, 180):
        pose = np.eye(4)
        level = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
        axis = "x" if angle == 90 else "z"
        pose[:3, :3] = level @ Rotation.from_euler(axis, angle, degrees=True).as_matrix()
        np.testing.assert_array_equal(level_up(np.array([0.0, 0.0, 1.0]), pose), -pose[:3, 1])
