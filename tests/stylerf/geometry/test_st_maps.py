"""Lens cameras and ST maps against COLMAP's cameras, and a checkerboard resampled by scipy alone."""

import numpy as np
import pycolmap
import pytest
from scipy.ndimage import map_coordinates

from stylerf.geometry.camera_paths import look_at
from stylerf.geometry.cameras import Camera
from stylerf.geometry.distortion import from_colmap, pinhole_of
from stylerf.geometry.lens_camera import LensCamera, at_size, through_lens
from stylerf.geometry.st_maps import NOWHERE, redistort_map, undistort_map

SIZE = (160, 120)
MODELS = {
    "OPENCV": [130.0, 134.0, 82.0, 57.0, -0.18, 0.04, 0.004, -0.003],
    "OPENCV_FISHEYE": [90.0, 92.0, 80.0, 61.0, 0.05, -0.02, 0.01, -0.003],
    "PINHOLE": [130.0, 134.0, 82.0, 57.0],
}


def pair(model: str) -> tuple[LensCamera, Camera]:
    """The plate's camera and the one of its undistorted picture, at the plate's size."""
    intrinsics, lens = from_colmap(model, MODELS[model])
    pose = look_at(np.array([3.0, 1.0, 0.5]), np.zeros(3), np.array([0, 0, 1.0]))
    pinhole = Camera("view", *SIZE, *pinhole_of(SIZE, intrinsics, lens), pose)
    return through_lens(pinhole, SIZE, intrinsics, lens), pinhole


def positions(stored: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Pixels from the upper left corner (x, y), from u and v with the origin at the lower left."""
    return np.stack([stored[..., 0] * size[0], (1 - stored[..., 1]) * size[1]], axis=-1)


def looked_up(picture: np.ndarray, stored: np.ndarray, order: int = 3) -> np.ndarray:
    """Apply a map as Nuke's STMap does."""
    x, y = np.moveaxis(positions(stored, picture.shape[1::-1]), -1, 0)
    return map_coordinates(picture, [y - 0.5, x - 0.5], order=order, mode="nearest")


@pytest.mark.parametrize("model", MODELS)
def test_rays_are_those_colmap_casts(model):
    plate, _ = pair(model)
    camera = pycolmap.Camera(model=model, width=SIZE[0], height=SIZE[1], params=MODELS[model])
    rows, columns = np.mgrid[0 : SIZE[1], 0 : SIZE[0]]
    points = np.asarray(camera.cam_from_img(np.stack([columns + 0.5, rows + 0.5], -1).reshape(-1, 2)))
    local = np.column_stack([points[:, :2], np.ones(len(points))])
    expected = local @ plate.world_from_camera[:3, :3].T
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    origins, directions = plate.rays()
    np.testing.assert_allclose(directions, expected, atol=2e-6)
    np.testing.assert_allclose(origins, np.tile(plate.center, (len(points), 1)), atol=1e-6)
    some = np.array([5, 700, 19000])
    assert np.array_equal(plate.rays(some)[1], directions[some])
    cosines = 1 / np.linalg.norm(local, axis=1)
    np.testing.assert_allclose(plate.ray_cosines().ravel(), cosines, rtol=1e-5)
    assert plate.has_ray().all()


@pytest.mark.parametrize("model", MODELS)
def test_the_maps_of_a_lens_undo_each_other(model):
    plate, pinhole = pair(model)
    undistort, redistort = undistort_map(plate, pinhole), redistort_map(plate, pinhole)
    inside = (redistort > 0.02).all(-1) & (redistort < 0.98).all(-1)
    assert inside.mean() > 0.5
    # Where the redistorted pixel comes from in the undistorted picture, and where that comes from on the plate.
    back = np.stack([looked_up(undistort[..., axis].astype(float), redistort) for axis in (0, 1)], axis=-1)
    rows, columns = np.mgrid[0 : SIZE[1], 0 : SIZE[0]]
    found = positions(back, SIZE) - np.stack([columns + 0.5, rows + 0.5], axis=-1)
    assert np.abs(found[inside]).max() < 0.05


def test_the_identity_has_pixel_centers_and_its_origin_below():
    plate, pinhole = pair("PINHOLE")
    stored = redistort_map(plate, pinhole)
    width, height = SIZE
    np.testing.assert_allclose(stored[-1, 0], [0.5 / width, 0.5 / height], atol=1e-6)
    np.testing.assert_allclose(stored[0, -1], [1 - 0.5 / width, 1 - 0.5 / height], atol=1e-6)
    np.testing.assert_allclose(undistort_map(plate, pinhole), stored, atol=1e-6)


def checkers(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Smooth ones, of points (X/Z, Y/Z)."""
    return 0.5 + 0.5 * np.sin(14 * x) * np.sin(14 * y)


def test_a_checkerboard_seen_through_a_lens_is_straightened_and_bent_back():
    plate, pinhole = pair("OPENCV")
    camera = pycolmap.Camera(model="OPENCV", width=SIZE[0], height=SIZE[1], params=MODELS["OPENCV"])
    rows, columns = np.mgrid[0 : SIZE[1], 0 : SIZE[0]] + 0.5
    through = np.asarray(camera.cam_from_img(np.stack([columns, rows], -1).reshape(-1, 2)))
    photo = checkers(through[:, 0], through[:, 1]).reshape(SIZE[::-1])
    straight = checkers((columns - pinhole.cx) / pinhole.fx, (rows - pinhole.cy) / pinhole.fy)
    assert np.abs(photo - straight).max() > 0.2
    undistort, redistort = undistort_map(plate, pinhole), redistort_map(plate, pinhole)
    np.testing.assert_allclose(looked_up(photo, undistort)[3:-3, 3:-3], straight[3:-3, 3:-3], atol=0.01)
    inside = (redistort > 0.02).all(-1) & (redistort < 0.98).all(-1)
    np.testing.assert_allclose(looked_up(straight, redistort)[inside], photo[inside], atol=0.01)


def test_what_a_lens_shows_from_no_direction_has_no_ray():
    intrinsics, lens = from_colmap("OPENCV_FISHEYE", [30.0, 30.0, 80.0, 60.0, 0.0, 0.0, 0.0, 0.0])
    pinhole = Camera("view", *SIZE, *pinhole_of(SIZE, intrinsics, lens), np.eye(4))
    plate = through_lens(pinhole, SIZE, intrinsics, lens)
    rows, columns = np.mgrid[0 : SIZE[1], 0 : SIZE[0]] + 0.5
    angle = np.hypot(columns - 80, rows - 60) / 30  # an equidistant fisheye: the angle from the axis
    assert not plate.has_ray()[angle > 1.6].any() and plate.has_ray()[angle < 1.4].all()
    assert (redistort_map(plate, pinhole)[angle > 1.6] == NOWHERE).all()
    assert np.isfinite(plate.rays()[1]).all() and np.isfinite(plate.ray_cosines()).all()


def test_scaled_plates_keep_their_rays():
    plate, pinhole = pair("OPENCV")
    half = plate.scaled(0.5)
    assert isinstance(half, LensCamera) and (half.width, half.height) == (80, 60)
    whole = plate.points()
    np.testing.assert_allclose(half.points(), whole.reshape(60, 2, 80, 2, 2).mean((1, 3)), atol=3e-4)
    other = at_size(pinhole, (80, 60))
    assert (other.fx, other.cy) == pytest.approx((pinhole.fx / 2, pinhole.cy / 2))
