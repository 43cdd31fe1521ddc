"""Registered rays against planes whose correspondences are known in closed form; what is hidden, what is behind."""

import numpy as np
import pytest

from stylerf.fields.packed_surface import PackedSurface, surface_of
from stylerf.geometry.camera_paths import look_at
from stylerf.geometry.cameras import Camera
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.rendering.ray_registration import SeenPoints, best_reference, every, points_of, registered, sampled_at
from tests.stylerf.small import wall_in_front

SPACE = SpaceWarp.box([-4, -4, -4], [4, 4, 4])
NORMAL, OFFSET = np.array([0.15, -0.1, 1.0]), 0.2  # the plane NORMAL x = OFFSET
SCREEN = 1.5, 0.5  # height of a square before the plane, half its side


def camera(eye, width: int = 40, height: int = 30, focal: float = 38.0, at=(0, 0, 0)) -> Camera:
    pose = look_at(np.array(eye, float), np.array(at, float), np.array([0, 1.0, 0]))
    return Camera("c", width, height, focal, focal * 1.1, width / 2 + 1.3, height / 2 - 0.7, pose)


def seeing(one: Camera, screen: bool = False) -> SeenPoints:
    """What a camera sees of the plane and, where there is one, of the square before it, by crossing its rays."""
    origins, directions = (a.astype(np.float64) for a in one.rays())
    distances = (OFFSET - origins @ NORMAL) / (directions @ NORMAL)
    if screen:
        nearer = (SCREEN[0] - origins[:, 2]) / directions[:, 2]
        hit = (np.abs((origins + nearer[:, None] * directions)[:, :2]) < SCREEN[1]).all(1) & (nearer > 0)
        distances = np.where(hit & (nearer < distances), nearer, distances)
    points = origins + distances[:, None] * directions
    inside = (distances > 0) & (np.abs(points) < 4).all(1)
    return SeenPoints(one, points, SPACE.warp(points), inside)


def homography(one: Camera, other: Camera) -> np.ndarray:
    """[3, 3] from pixels of `one` to pixels of `other`, induced by the plane: K' (R + t n^T / d) K^-1."""

    def intrinsics(c: Camera) -> np.ndarray:
        return np.array([[c.fx, 0, c.cx], [0, c.fy, c.cy], [0, 0, 1]])

    relative = np.linalg.inv(other.world_from_camera) @ one.world_from_camera
    turn, center = one.world_from_camera[:3, :3], one.center
    normal, distance = turn.T @ NORMAL, OFFSET - NORMAL @ center
    induced = relative[:3, :3] + np.outer(relative[:3, 3], normal) / distance
    return intrinsics(other) @ induced @ np.linalg.inv(intrinsics(one))


def test_pixels_of_a_plane_are_registered_where_its_homography_says():
    one, other = camera((0.8, 0.3, 3.2)), camera((-0.5, -0.4, 3.0))
    pixels, positions, cosines = registered(seeing(one), seeing(other))
    rows, columns = np.divmod(np.arange(one.width * one.height), one.width)
    mapped = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))]).T @ homography(one, other).T
    mapped = mapped[:, :2] / mapped[:, 2:]
    within = (mapped > 0).all(1) & (mapped[:, 0] < other.width) & (mapped[:, 1] < other.height)
    assert np.array_equal(pixels, np.flatnonzero(within)) and 300 < len(pixels) < within.size
    assert np.abs(positions - mapped[pixels]).max() < 1e-3
    points = seeing(one).points[pixels]
    ways = [(points - c.center) / np.linalg.norm(points - c.center, axis=1, keepdims=True) for c in (one, other)]
    np.testing.assert_allclose(cosines, (ways[0] * ways[1]).sum(1), atol=1e-9)


def test_what_a_square_hides_from_the_reference_is_not_registered():
    one, other = camera((1.6, 0.2, 3.0), 60, 44, 55.0), camera((-1.4, 0, 3.0), 60, 44, 55.0)
    seen = seeing(one, screen=True)
    found = np.zeros(len(seen.there), bool)
    found[registered(seen, seeing(other, screen=True))[0]] = True
    on_plane = np.abs(seen.points @ NORMAL - OFFSET) < 1e-6
    # Along the segment from the point to the reference's center, where the square's height is passed.
    share = (SCREEN[0] - seen.points[:, 2]) / (other.center[2] - seen.points[:, 2])
    passing = np.abs((seen.points + share[:, None] * (other.center - seen.points))[:, :2]).max(1)
    inside = other.project(seen.points)[0]
    inside = (inside > 1).all(1) & (inside[:, 0] < other.width - 1) & (inside[:, 1] < other.height - 1)
    hidden = on_plane & inside & (passing < SCREEN[1] - 0.06)  # but for a pixel at the square's rim
    clear = on_plane & inside & (passing > SCREEN[1] + 0.06)
    assert hidden.sum() > 50 and not found[hidden].any()
    assert clear.sum() > 300 and found[clear].all()


def test_the_other_side_and_what_is_not_there_are_not_registered():
    seen, behind = seeing(camera((0.2, 0, 3))), seeing(camera((0, 0.1, -3)))
    assert len(registered(seen, behind)[0]) == 0 and len(registered(seen, seeing(camera((0, 0, 2.9))))[0]) > 300
    nothing = SeenPoints(seen.camera, seen.points, seen.places, np.zeros_like(seen.there))
    assert len(registered(seen, nothing)[0]) == len(registered(nothing, seen)[0]) == 0


def test_the_best_reference_sees_what_the_others_see():
    left, right = (seeing(camera((x, 0, 2.5), focal=60.0, at=(x, 0, 0))) for x in (-0.8, 0.8))
    wide = seeing(camera((0.05, 0, 3.2), focal=25.0))
    assert best_reference([left, right, wide]) == 2 and best_reference([wide, left, right]) == 0


@pytest.mark.parametrize("stride", [1, 3, 7])
def test_a_strided_camera_has_the_rays_of_every_so_many_pixels(stride):
    one = camera((0.8, 0.3, 3.2))
    grid = np.arange(one.width * one.height).reshape(one.height, one.width)[::stride, ::stride]
    few = every(one, stride)
    assert (few.height, few.width) == grid.shape
    np.testing.assert_allclose(few.rays()[1], one.rays(grid.ravel())[1], atol=1e-6)


def test_points_are_the_weighted_means_of_a_pixels_samples():
    one = camera((0, 0, 3), 3, 1)
    x = np.array([[10, 20, 30], [30, 20, 10], [60000, 5, 7], [1, 2, 3]], np.uint16)
    weights = np.array([0.6, 0.2, 0.9, 0.1], np.float32)
    alpha = np.array([[0.8, 0.9, 0.1]], np.float32)
    found = points_of(PackedSurface(np.array([0, 2, 3, 4]), x, weights, alpha), one, SPACE)
    places = x / 65535
    expected = [(0.6 * places[0] + 0.2 * places[1]) / 0.8, places[2], places[3]]
    np.testing.assert_allclose(found.places, expected, atol=1e-5)
    np.testing.assert_allclose(found.points, np.array(expected) * 8 - 4, atol=1e-4)
    assert found.there.tolist() == [True, True, False]


def test_a_picture_is_sampled_linearly_and_level_outside():
    rows, columns = np.mgrid[:5, :7] + 0.5
    picture = np.stack([2 * columns - rows, 3 + 0 * rows, rows], -1).astype(np.float32)
    at = np.array([[3.2, 2.9], [0.5, 0.5], [6.5, 4.5], [6.1, 0.6]])
    expected = np.stack([2 * at[:, 0] - at[:, 1], np.full(4, 3.0), at[:, 1]], 1)
    np.testing.assert_allclose(sampled_at(picture, at), expected, rtol=1e-6)
    np.testing.assert_allclose(sampled_at(picture, np.array([[-5.0, 9.0]])), picture[4:5, 0])
    np.testing.assert_allclose(sampled_at(picture[:1, :1], np.array([[0.9, 0.2]])), picture[:1, 0])


def test_a_point_lies_on_the_surface_whatever_light_passes_it():
    field, one = wall_in_front(0.3), Camera("c", 5, 4, 40.0, 40.0, 2.5, 2.0, np.eye(4))
    seen = points_of(surface_of(field, one, 0.02, 1), one, field.space)
    assert seen.there.all()
    np.testing.assert_allclose(seen.points[:, 2], 3, rtol=0.05)
