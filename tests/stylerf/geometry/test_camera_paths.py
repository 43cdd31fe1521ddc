"""Camera paths by what is known of them: circles, arcs, common points, the cameras themselves."""

from dataclasses import replace

import numpy as np
import pytest

from stylerf.errors import InvalidValue
from stylerf.geometry.camera_paths import PATHS, average_up, focus_point, look_at, path_camera
from stylerf.geometry.cameras import Camera

FOCUS, UP = np.array([0.5, -1.0, 0.2]), np.array([0, 0, 1.0])


def camera(center, target=FOCUS, name="c") -> Camera:
    return Camera(
        name, 40, 30, 33.0, 34.0, 20.0, 15.0, look_at(np.asarray(center, float), np.asarray(target, float), UP)
    )


def ring(degrees, radius=3.0, height=1.5) -> list[Camera]:
    angles = np.radians(degrees)
    return [
        camera(FOCUS + [radius * np.cos(a), radius * np.sin(a), height], name=f"r{i}") for i, a in enumerate(angles)
    ]


def facing() -> list[Camera]:
    """A grid of cameras that all look along +y."""
    return [camera((x, 0, z), (x, 10, z)) for x in (-1.0, 0.0, 1.0) for z in (-0.5, 0.0, 0.5)]


def walk() -> list[Camera]:
    """Along a bent line, in no order."""
    places = [camera((x, -4 + 0.1 * x**2, 0.5), name=f"w{i}") for i, x in enumerate(np.arange(-2, 3.0))]
    return [places[i] for i in (2, 4, 0, 3, 1)]


def path(kind: str, cameras: list[Camera], count: int, focus_depth=6.0) -> list[Camera]:
    return [path_camera(kind, cameras, i, count, focus_depth) for i in range(count)]


def test_look_at_is_a_rotation_with_up_at_the_top():
    made = camera((3, 1, 2))
    np.testing.assert_allclose(made.world_from_camera[:3, :3] @ made.world_from_camera[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(made.world_from_camera[:3, :3]) == pytest.approx(1)
    pixels, depth = made.project(np.stack([FOCUS, FOCUS + [0, 0, 0.1]]))
    assert pixels[0].tolist() == pytest.approx([20, 15]) and depth[0] == pytest.approx(
        np.linalg.norm(FOCUS - [3, 1, 2])
    )
    assert pixels[1, 1] < 15 and pixels[1, 0] == pytest.approx(20)
    with pytest.raises(InvalidValue, match="zero length"):
        look_at(FOCUS + UP, FOCUS, UP)


@pytest.mark.parametrize(
    ("kind", "cameras"), [("orbit", ring(range(0, 360, 15))), ("spiral", facing()), ("interpolate", walk())]
)
def test_a_frame_depends_on_its_index_and_the_count_alone(kind, cameras):
    whole = path(kind, cameras, 7)
    for i in (6, 0, 3):
        assert np.array_equal(path_camera(kind, cameras, i, 7, 6.0).world_from_camera, whole[i].world_from_camera)
    for i, frame in enumerate(whole):
        assert frame.name == f"{i:04d}"
        assert replace(frame, name="").fx == cameras[0].fx and (frame.width, frame.height) == (40, 30)
        turn = frame.world_from_camera[:3, :3]
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-9)
        assert np.linalg.det(turn) == pytest.approx(1) and frame.world_from_camera[3].tolist() == [0, 0, 0, 1]


def test_focus_is_where_axes_meet_or_ahead_of_parallel_ones():
    np.testing.assert_allclose(focus_point(ring((0, 50, 170))), FOCUS, atol=1e-4)
    np.testing.assert_allclose(average_up(ring(range(0, 360, 30))), UP, atol=1e-12)
    parallel = focus_point(facing())
    np.testing.assert_allclose(parallel[[0, 2]], 0, atol=1e-6)
    assert np.isfinite(parallel).all()


def test_an_orbit_of_cameras_all_around_is_a_full_even_circle():
    frames = path("orbit", ring(range(0, 360, 15)), 12)
    offsets = np.array([f.center for f in frames]) - FOCUS
    np.testing.assert_allclose(np.linalg.norm(offsets[:, :2], axis=1), 3, atol=1e-3)
    np.testing.assert_allclose(offsets[:, 2], 1.5, atol=1e-3)
    turns = np.diff(np.unwrap(np.arctan2(offsets[:, 1], offsets[:, 0])))
    np.testing.assert_allclose(turns, 2 * np.pi / 12, atol=1e-3)
    for frame in frames:
        assert frame.project(focus_point(ring(range(0, 360, 15)))[None])[0][0].tolist() == pytest.approx([20, 15])


def test_an_orbit_may_begin_at_a_camera_right_above_the_focus():
    top = []
    for way in (1.0, -1.0):  # their own ups cancel out
        pose = look_at(FOCUS + [0, 0, 3], FOCUS, np.array([way, 0, 0]))
        top.append(replace(camera(FOCUS + [1, 0, 3]), world_from_camera=pose))
    frames = path("orbit", [*top, *ring(range(0, 360, 15))], 12)
    distances = [np.linalg.norm((one.center - FOCUS)[:2]) for one in frames]
    assert np.allclose(distances, 3.0, atol=1e-6)


def test_an_orbit_of_an_arc_swings_within_it_and_comes_back():
    frames = path("orbit", ring(range(-50, 60, 10), height=0.0), 40)
    offsets = np.array([f.center for f in frames]) - FOCUS
    angles = np.degrees(np.arctan2(offsets[:, 1], offsets[:, 0]))
    assert angles.min() == pytest.approx(-45, abs=0.1) and angles.max() == pytest.approx(45, abs=0.1)
    np.testing.assert_allclose(angles[1:], angles[:0:-1], atol=1e-6)  # there and back alike
    assert abs(angles[0] - angles[-1]) < 2 and np.abs(np.diff(angles)).max() < 10  # no jump where it closes


def parting() -> list[Camera]:
    """On an arc that looks outward: their axes meet behind them."""
    return [camera(c.center, 2 * c.center - FOCUS) for c in ring(range(-30, 31, 10), height=0.0)]


@pytest.mark.parametrize("cameras", [facing(), parting()])
def test_cameras_that_look_in_one_direction_swing_before_what_they_see(cameras):
    """Whichever way their axes meet: an orbit around that place would look away from the photos' subject."""
    frames = path("orbit", cameras, 20, focus_depth=6.0)
    mean = np.array([c.center for c in cameras]).mean(0)
    forward = np.array([c.forward for c in cameras]).mean(0)
    target = mean + 6.0 * forward / np.linalg.norm(forward)
    for frame in frames:
        toward = target - frame.center
        np.testing.assert_allclose(frame.forward, toward / np.linalg.norm(toward), atol=1e-9)
    widest = max(np.linalg.norm(c.center - mean) for c in cameras)
    assert 0.3 * widest < max(np.linalg.norm(f.center - mean) for f in frames) < 1.3 * widest


def test_a_spiral_looks_at_one_point_and_makes_two_turns():
    frames = path("spiral", facing(), 24, focus_depth=6.0)
    target = np.array([0, 6.0, 0])
    for frame in frames:
        toward = target - frame.center
        np.testing.assert_allclose(frame.forward, toward / np.linalg.norm(toward), atol=1e-9)
    centers = np.array([f.center for f in frames])
    # As wide as 80 % of the cameras: a grid of -1, 0, 1 by -0.5, 0, 0.5, all in the plane y = 0.
    np.testing.assert_allclose(centers[:, 0], np.cos(4 * np.pi * np.arange(24) / 24), atol=1e-9)
    np.testing.assert_allclose(np.abs(centers[:, 2]), 0.5 * np.abs(np.sin(4 * np.pi * np.arange(24) / 24)), atol=1e-9)
    assert not centers[:, 1].round(9).any()


def test_a_spiral_of_cameras_around_a_place_looks_at_that_place():
    """However far the depth says that it should look."""
    for frame in path("spiral", ring(range(-60, 61, 15)), 8, focus_depth=50.0):
        toward = FOCUS - frame.center
        np.testing.assert_allclose(frame.forward, toward / np.linalg.norm(toward), atol=1e-3)


def test_interpolation_visits_every_camera_once_by_nearest_neighbor():
    cameras = walk()
    frames = path("interpolate", cameras, 9)
    order = [frame.center for frame in frames[::2]]
    places = sorted((c.center.tolist() for c in cameras), key=lambda c: c[0], reverse=bool(order[0][0] > 0))
    np.testing.assert_allclose(order, places, atol=1e-9)
    by_place = {tuple(np.round(c.center, 6)): c for c in cameras}
    for frame in frames[::2]:
        same = by_place[tuple(np.round(frame.center, 6))]
        np.testing.assert_allclose(frame.world_from_camera, same.world_from_camera, atol=1e-9)
    # Half-way the axis has made half the turn: the bisector of its neighbors'.
    middle = frames[2].forward + frames[4].forward
    np.testing.assert_allclose(frames[3].forward, middle / np.linalg.norm(middle), atol=2e-3)


def test_interpolating_evenly_spaced_cameras_moves_straight_and_evenly():
    cameras = [camera((x, 0, 0), (x, 5, 0)) for x in np.arange(5.0)]
    centers = np.array([f.center for f in path("interpolate", cameras, 41)])[10:31]  # the ends start at rest
    np.testing.assert_allclose(np.abs(np.diff(centers[:, 0])), 0.1, atol=1e-9)
    assert not centers[:, 1:].round(9).any()


def test_one_camera_alone():
    alone = ring([20])
    for frame in path("interpolate", alone, 3):
        assert np.array_equal(frame.world_from_camera, alone[0].world_from_camera)
    assert len(path("spiral", alone, 3)) == 3


def test_no_camera_and_an_unknown_path_are_refused():
    for kind in PATHS:
        with pytest.raises(InvalidValue, match="cameras"):
            path_camera(kind, [], 0, 1, 1.0)
    with pytest.raises(InvalidValue, match="zigzag"):
        path_camera("zigzag", ring([0]), 0, 1, 1.0)
