"""View consistency on planes whose pictures are known in closed form."""

import numpy as np
import pytest

from stylerf.errors import InvalidValue
from stylerf.geometry.cameras import Camera
from stylerf.metrics.consistency import PosedView, pair_consistency, seen_through, warp


def camera_at(x=0.0, y=0.0, yaw=0.0, size=(64, 48), name="camera"):
    pose = np.eye(4)
    pose[:3, :3] = [[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]]
    pose[:3, 3] = [x, y, 0]
    width, height = size
    return Camera(name, width, height, 60.0, 60.0, width / 2, height / 2, pose)


def texture(x, y):
    return np.stack([0.5 + 0.4 * np.sin(3 * x), 0.5 + 0.4 * np.cos(2 * y), 0.5 + 0.3 * np.sin(2 * (x + y))], axis=-1)


def see(camera, planes):
    """Exact picture of planes z = depth that hold only x in [low, high]; the nearest one wins, black where none."""
    origins, directions = (a.astype(np.float64) for a in camera.rays())
    image, depth = np.zeros((len(origins), 3)), np.full(len(origins), np.inf)
    for plane_z, low, high, shade in planes:
        t = (plane_z - origins[:, 2]) / directions[:, 2]
        hit = origins + t[:, None] * directions
        seen = (t > 0) & (hit[:, 0] >= low) & (hit[:, 0] <= high) & (t < depth)
        image[seen] = shade * texture(hit[seen, 0], hit[seen, 1])
        depth[seen] = t[seen]
    size = (camera.height, camera.width)
    alpha = np.isfinite(depth).astype(float).reshape(size)
    z = np.where(alpha > 0, np.where(np.isfinite(depth), depth, 0).reshape(size) * camera.ray_cosines(), 1e10)
    return PosedView(camera, image.reshape(*size, 3), alpha, z)


PLANE = [(3.0, -50.0, 50.0, 1.0)]


def test_a_plane_seen_twice_is_consistent():
    a, b = see(camera_at(), PLANE), see(camera_at(x=0.4, y=-0.1, yaw=0.1), PLANE)
    found = pair_consistency(a, b)
    # Bilinear error is at most pitch^2 / 8 * curvature = 0.05^2 / 8 * (0.4 * 9) = 1.1e-3 along x.
    assert found.rmse < 1.1e-3
    assert found.share > 0.65
    assert found.pixels == pytest.approx(found.share * 64 * 48)


def test_warp_is_the_homography_of_the_plane():
    a, b = see(camera_at(), PLANE), see(camera_at(x=0.3, yaw=-0.08), PLANE)
    warped, visible = warp(a, b)
    k = np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]])
    a_from_b = a.camera.camera_from_world @ b.camera.world_from_camera
    normal = b.camera.world_from_camera[2, :3]  # plane z = 3 of the world, in b's axes
    distance = 3.0 - b.camera.center[2]
    homography = k @ (a_from_b[:3, :3] + np.outer(a_from_b[:3, 3], normal) / distance) @ np.linalg.inv(k)
    for row, column in [(10, 12), (24, 32), (40, 30)]:
        assert visible[row, column]
        x, y, w = homography @ [column + 0.5, row + 0.5, 1]
        u, v = x / w - 0.5, y / w - 0.5
        i, j = int(u), int(v)
        patch = a.image[j : j + 2, i : i + 2]
        rows = patch[0] * (1 - (v - j)) + patch[1] * (v - j)
        np.testing.assert_allclose(warped[row, column], rows[0] * (1 - (u - i)) + rows[1] * (u - i), atol=1e-6)


def test_a_view_onto_itself_is_exact():
    a = see(camera_at(), PLANE)
    found = pair_consistency(a, a, erode=0)
    assert found.rmse < 1e-6 and found.share == 1.0


def test_a_wrong_pose_shows():
    a, b = see(camera_at(), PLANE), see(camera_at(x=0.4), PLANE)
    lied = PosedView(camera_at(x=0.55), b.image, b.alpha, b.z)
    assert pair_consistency(a, lied).rmse > 20 * pair_consistency(a, b).rmse


def test_only_the_pixels_requested_about_count():
    a, b = see(camera_at(), PLANE), see(camera_at(x=0.1), PLANE)
    left = np.zeros((48, 64), bool)
    left[:, :32] = True
    image = b.image.copy()
    image[:, 32:] += 0.2  # the right half tells another story
    other = PosedView(b.camera, image, b.alpha, b.z)
    assert pair_consistency(a, other, within=left).rmse == pytest.approx(pair_consistency(a, b, within=left).rmse)
    assert pair_consistency(a, other, within=~left).rmse > 0.15
    assert 0.8 < pair_consistency(a, b, within=left, erode=0).share <= 1
    assert pair_consistency(a, b, within=np.zeros_like(left)).rmse is None


def test_occlusion_is_excluded():
    planes = [(3.0, -50.0, 50.0, 1.0), (1.5, -0.2, 0.2, 0.3)]  # a dark board before the wall
    a, b = see(camera_at(), planes), see(camera_at(x=0.5), planes)
    _, visible = warp(a, b)
    honest = pair_consistency(a, b)
    assert honest.rmse < 2e-3
    # The wall behind a's board: a cannot know its color, b sees it at x = 0.2 .. 0.4 * 1.5 or so.
    points = b.camera.unproject(
        np.stack(np.meshgrid(np.arange(64) + 0.5, np.arange(48) + 0.5), -1).reshape(-1, 2), b.z.reshape(-1)
    )
    hidden = (np.abs(points[:, 0]) < 0.38) & (points[:, 2] > 2)
    assert hidden.sum() > 50 and not visible.reshape(-1)[hidden].any()
    blind = pair_consistency(a, b, tolerance=10.0)  # without the depth test the board leaks in
    assert blind.rmse > 20 * honest.rmse


def test_perceptual_distance_is_averaged_over_visible_pixels_only():
    planes = [(3.0, -50.0, 0.3, 1.0)]
    a, b = see(camera_at(), planes), see(camera_at(x=0.1), planes)
    _, visible = warp(a, b)
    assert 0 < visible.sum() < 64 * 48

    def distance(first, second):
        assert first.dtype == np.float32 and np.isfinite(first).all()
        assert (first == second)[~visible].all()
        return np.abs(first - second).mean(axis=-1) + np.where(visible, 1.0, 5.0)

    assert pair_consistency(a, b, perceptual=distance).perceptual == pytest.approx(1.0, abs=5e-3)


def test_nothing_in_common_is_said_and_not_a_number_is_refused():
    a, away = see(camera_at(), PLANE), see(camera_at(x=500.0), [(3.0, 400.0, 600.0, 1.0)])
    assert pair_consistency(a, away) == pair_consistency(away, a)
    assert pair_consistency(a, away).rmse is None and pair_consistency(a, away).share == 0
    broken = a.image.copy()
    broken[20, 20] = np.nan
    with pytest.raises(InvalidValue, match="not finite"):
        pair_consistency(PosedView(a.camera, broken, a.alpha, a.z), a)
    with pytest.raises(InvalidValue, match="do not fit"):
        PosedView(a.camera, a.image[:-1], a.alpha, a.z)


def test_a_floater_is_seen_through():
    a, b = see(camera_at(), PLANE), see(camera_at(x=0.3), PLANE)
    assert seen_through(a, b) == 0
    floating = a.z.copy()
    floating[10:30, 20:40] = 1.0  # an opaque patch that the other view does not know
    share = seen_through(PosedView(a.camera, a.image, a.alpha, floating), b)
    assert share > 0.05
    assert seen_through(a, see(camera_at(x=500.0), PLANE)) is None
