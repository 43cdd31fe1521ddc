"""The page's camera as the renderer's."""

import numpy as np
import pytest

from stages.viewing.cameras import Pose, pixel_at
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
