"""Layout, normalizing similarity, bounds and visual hull on captures whose answers are known."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from stylerf.errors import InvalidValue
from stylerf.geometry import scene_normalization
from stylerf.geometry.silhouette_bounds import hull_box, silhouette
from tests.stages.photo_room import look_at
from tests.stylerf.geometry.test_camera_conventions import random_rotation

FOCUS = np.array([2.0, -1.0, 0.5])


def ring(count=24, radius=4.0, height=1.5, focus=FOCUS):
    angles = np.linspace(0, 2 * np.pi, count, endpoint=False)
    offsets = np.stack([radius * np.cos(angles), radius * np.sin(angles), np.full(count, height)], axis=1)
    return [look_at(focus + offset, focus, f"v{i}") for i, offset in enumerate(offsets)]


def poses_of(cameras):
    return np.array([camera.world_from_camera for camera in cameras])


def forward(count=9):
    return [look_at((x, -3 + 0.05 * x, 0.1 * np.sin(x)), (0.2 * x, 30, 0)) for x in np.linspace(-1, 1, count)]


def turned(poses, seed=4, scale=0.3, shift=(5, 6, -7)):
    """The same capture in another frame: any reader's world is arbitrary."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = scale * random_rotation(seed), shift
    return np.array([scene_normalization.moved(pose, matrix) for pose in poses])


def test_layouts_are_reported_from_the_cameras():
    assert scene_normalization.decided_layout(poses_of(ring()), "").name == "unbounded"
    assert scene_normalization.decided_layout(poses_of(ring()), "transparency").name == "object"
    found = scene_normalization.decided_layout(poses_of(forward()), "")
    assert found.name == "forward" and "degrees" in found.reason
    assert scene_normalization.decided_layout(turned(poses_of(forward())), "").name == "forward"


def test_centering_puts_the_focus_at_the_origin_at_unit_distance():
    for poses in (poses_of(ring()), turned(poses_of(ring()))):
        matrix = scene_normalization.centered(poses)
        moved = np.array([scene_normalization.moved(pose, matrix) for pose in poses])
        np.testing.assert_allclose(np.linalg.norm(moved[:, :3, 3], axis=1), 1, atol=1e-6)
        np.testing.assert_allclose(moved[:, :3, 3].std(0)[2], 0, atol=1e-6)  # all at one height: the axis is z
        assert (moved[:, 2, 3] > 0).all()
        toward = -moved[:, :3, 3]
        np.testing.assert_allclose((moved[:, :3, 2] * toward).sum(1), 1, atol=1e-6)  # all look at the origin
        assert np.allclose(np.linalg.inv(matrix) @ matrix, np.eye(4))


def test_moving_a_pose_and_a_point_keeps_the_pixel():
    camera = ring()[5]
    matrix = scene_normalization.similarity(0.7, random_rotation(8), np.array([1.0, 2, 3]))
    points = FOCUS + np.random.default_rng(0).normal(size=(10, 3)) * 0.3
    other = replace(camera, world_from_camera=scene_normalization.moved(camera.world_from_camera, matrix))
    moved = points @ matrix[:3, :3].T + matrix[:3, 3]
    np.testing.assert_allclose(other.project(moved)[0], camera.project(points)[0], atol=1e-8)
    np.testing.assert_allclose(other.project(moved)[1], 0.7 * camera.project(points)[1], atol=1e-9)


def test_facing_looks_along_z_with_y_down_and_near_before_everything():
    for poses in (poses_of(forward()), turned(poses_of(forward()))):
        nearest = 20.0
        matrix = scene_normalization.facing(poses, nearest)
        moved = np.array([scene_normalization.moved(pose, matrix) for pose in poses])
        np.testing.assert_allclose(moved[:, :3, 3].mean(0), 0, atol=1e-9)
        mean = moved[:, :3, :3].mean(0)
        assert mean[2, 2] > 0.99 and mean[1, 1] > 0.99 and mean[0, 0] > 0.99
        scale = np.cbrt(np.linalg.det(matrix[:3, :3]))
        assert abs(scale * nearest - 4 / 3) < 1e-9  # the near plane at 1 is three quarters of it


@pytest.mark.parametrize("center", [(0, 0, 0), (1, 1, 1), (0.1, 0.2, 0.3), (1e-3, 0, 0), (5e5, 4e6, 120)])
@pytest.mark.parametrize("kept_in", [np.float32, np.float64])
def test_cameras_at_one_point_are_refused(center, kept_in):
    """Differing by rounding, as after a turn of the camera and back in the numbers that a tool keeps."""
    poses = poses_of(ring())
    for pose in poses:
        turn = pose[:3, :3].astype(kept_in)
        pose[:3, 3] = turn @ (turn.T @ kept_in(center))
    for refusal in (
        scene_normalization.focus_of,
        scene_normalization.centered,
        lambda all: scene_normalization.nearest_depth(all, None, None),
    ):
        with pytest.raises(InvalidValue, match="one point"):
            refusal(poses)


@pytest.mark.parametrize("scale", [1e-9, 1e-4, 1e6])
@pytest.mark.parametrize("capture", [ring, forward])
def test_coincident_cameras_are_found_in_any_unit_and_origin(capture, scale):
    poses = poses_of(capture())
    wanted = np.cbrt(np.linalg.det(scene_normalization.centered(poses)[:3, :3]))
    small, far = poses.copy(), poses.copy()
    small[:, :3, 3] *= scale
    far[:, :3, 3] += [5e5, 4e6, 120]  # meters of a map
    assert np.isclose(np.cbrt(np.linalg.det(scene_normalization.centered(small)[:3, :3])) * scale, wanted)
    assert np.isclose(np.cbrt(np.linalg.det(scene_normalization.centered(far)[:3, :3])), wanted, rtol=1e-4)


def test_a_baseline_too_small_for_the_depths_is_refused():
    poses = poses_of(forward())
    points = np.random.default_rng(0).uniform([-5, 20, -5], [5, 40, 5], (500, 3))
    reported = np.tile([17.0, 80.0], (9, 1))
    scene_normalization.check_baseline(poses, reported, points)
    poses[:, :3, 3] = 1e-6 * (poses[:, :3, 3] - poses[:, :3, 3].mean(0))
    for known in ((reported, None), (None, points)):
        with pytest.raises(InvalidValue, match=r"one point: within .* while the nearest depth is"):
            scene_normalization.check_baseline(poses, *known)
    scene_normalization.check_baseline(poses, None, None)  # nothing tells the depths


def test_forward_layouts_of_cameras_that_have_none():
    turned_about = poses_of(forward(2))
    turned_about[1] = turned_about[0] @ np.diag([-1.0, 1, -1, 1])
    turned_about[1, :3, 3] += 1
    with pytest.raises(InvalidValue, match="opposite directions"):
        scene_normalization.facing(turned_about, 20.0)
    rolled = poses_of(forward(2))
    rolled[1, :3, :3] = rolled[0, :3, :3] @ np.diag([-1.0, -1, 1])
    rolled[1, :3, 3] += 1
    assert np.isclose(np.linalg.det(scene_normalization.facing(rolled, 20.0)[:3, :3]), 1 / 15**3)


def test_nearest_depth_prefers_what_is_reported_then_points():
    poses, reported = poses_of(forward()), np.tile([17.0, 80.0], (9, 1))
    points = np.random.default_rng(0).uniform([-5, 20, -5], [5, 40, 5], (500, 3))
    assert scene_normalization.nearest_depth(poses, reported, points)[0] == 17
    near, known = scene_normalization.nearest_depth(poses, None, points)
    assert 22.5 < near < 23.5 and "points" in known  # cameras stand at y = -3, the points begin at y = 20
    assert "baseline" in scene_normalization.nearest_depth(poses, None, None)[1]


def test_many_points_in_many_views_take_little_memory(monkeypatch):
    poses = np.concatenate([poses_of(forward())] * 9)
    points = np.random.default_rng(0).uniform([-5, 20, -5], [5, 40, 5], (20_000, 3))
    exact, _ = scene_normalization.nearest_depth(poses, None, points)
    monkeypatch.setattr(scene_normalization, "MOST_DEPTHS", 20_000)
    tracemalloc.start()
    near, _ = scene_normalization.nearest_depth(poses, None, points)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert near == pytest.approx(exact, rel=0.02) and peak < 2e6  # all depths would take 60 MB


def ball(camera, radius, center=FOCUS):
    """Silhouette of a ball in closed form: rays whose distance to its center is under the radius."""
    origins, directions = camera.rays()
    along = ((center - origins) * directions).sum(1)
    away = np.linalg.norm(center - origins - along[:, None] * directions, axis=1)
    return (away < radius).reshape(camera.height, camera.width).astype(np.float32)


def test_the_hull_of_a_ball_holds_it_and_little_more():
    cameras = ring(12) + [look_at(FOCUS + [0.1, 0, 4.0], FOCUS), look_at(FOCUS + [0.1, 0, -4.0], FOCUS)]
    radius = 0.6
    masks = [silhouette(ball(camera, radius)) for camera in cameras]
    box = hull_box(cameras, masks, np.stack([FOCUS - 4, FOCUS + 4]))
    assert (box[0] <= FOCUS - radius).all() and (box[1] >= FOCUS + radius).all()
    assert (box[1] - box[0]).max() < 2 * radius * 1.35


def test_contradicting_silhouettes_are_refused():
    cameras = ring(8)
    masks = [silhouette(ball(camera, 0.3, FOCUS + [0, 0, 0.9 * (-1) ** i])) for i, camera in enumerate(cameras)]
    with pytest.raises(InvalidValue, match="silhouettes"):
        hull_box(cameras, masks, np.stack([FOCUS - 4, FOCUS + 4]))


def test_a_silhouette_keeps_single_pixels():
    alpha = np.zeros((301, 200), np.float32)
    alpha[300, 199] = 1
    small = silhouette(alpha)
    assert max(small.shape) < 200 and small.sum() == 1 and small[-1, -1]
