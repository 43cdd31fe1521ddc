"""Deep views: segments add up to the flat view, in order along the ray; a lens sees a cube where geometry puts it."""

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.camera_paths import look_at
from stylerf.geometry.cameras import Camera
from stylerf.geometry.distortion import from_colmap
from stylerf.geometry.lens_camera import LensCamera
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.rendering.deep import DeepCollector, DeepView
from stylerf.rendering.view import RenderedView, render_view
from tests.stylerf.small import SPACES, density, field_of, hash_color, vm_color, wall_in_front

BOX = SpaceWarp.box([-1, -1, -1], [1, 1, 1])
POSE = look_at(np.array([2.6, 0.9, 0.7]), np.zeros(3), np.array([0, 0, 1.0]))
CAMERA = Camera("view", 13, 9, 14.0, 15.0, 6.5, 4.5, POSE)


def both(field: RadianceField, camera: Camera, most: int, threads: int = 2) -> tuple[RenderedView, DeepView]:
    deep = DeepCollector(field, camera, most, threads)
    seen = render_view(field, camera, threads=threads, rays_at_once=40, on_rendered=deep.add)
    return seen, deep.view()


def summed(deep: DeepView) -> np.ndarray:
    """[h, w, 4]."""
    pixel = np.repeat(np.arange(deep.counts.size), deep.counts.ravel())
    values = np.column_stack([deep.rgb, deep.weights])
    added = [np.bincount(pixel, values[:, a], deep.counts.size) for a in range(4)]
    return np.stack(added, axis=-1).reshape(*deep.counts.shape, 4)


@pytest.mark.parametrize("most", [1, 3, 64])
@pytest.mark.parametrize("kind", ["box", "contraction"])
def test_segments_add_up_to_the_flat_view(kind, most):
    field = field_of(SPACES[kind], 1, vm_color(2))
    seen, deep = both(field, CAMERA, most)
    assert 1 <= deep.counts.max() <= most and len(deep.z) == deep.counts.sum()
    np.testing.assert_allclose(summed(deep)[..., 3], seen.alpha, atol=2e-6)
    np.testing.assert_allclose(summed(deep)[..., :3], seen.rgb, atol=2e-5)


def test_segments_are_in_order_and_do_not_overlap():
    _, deep = both(field_of(SPACES["contraction"], 1, vm_color(2)), CAMERA, 5)
    pixel = np.repeat(np.arange(deep.counts.size), deep.counts.ravel())
    assert (deep.z <= deep.z_back).all() and (deep.z > 0).all()
    following = pixel[1:] == pixel[:-1]
    assert following.sum() > 50
    assert (deep.z[1:][following] >= deep.z_back[:-1][following] * (1 - 1e-5)).all()


def test_two_walls_are_two_segments_each_at_its_depth():
    """Both let a half through: w = 1/2, 1/4, and the background takes the last quarter."""
    field = wall_in_front(0.5, backs=True)
    field.weight_threshold = 1e-3
    camera = Camera("view", 1, 1, 40.0, 40.0, 0.5, 0.5, np.eye(4))
    seen, deep = both(field, camera, 3)
    assert seen.alpha[0, 0] == pytest.approx(1, abs=1e-5) and deep.counts[0, 0] == 3
    np.testing.assert_allclose(deep.weights, [0.5, 0.25, 0.25], atol=2e-3)
    assert deep.z[0] < 3.1 < deep.z_back[0] * 1.05 and 2.8 < deep.z[0]
    assert 5.5 < deep.z[1] < deep.z_back[1] < 6.8
    assert deep.z[2] == deep.z_back[2] > 1e3


def test_a_volume_is_as_deep_as_its_box():
    """Even fog in a cube of side 2, seen along an axis from 3 before its front."""
    field = field_of(BOX, 1, hash_color(2), step=1 / 40)
    field.density = density(0, size=(2, 2, 2))
    field.density.values[:-1], field.density.values[-1] = 0, np.log(0.01)
    pose = look_at(np.array([4.0, 0, 0]), np.zeros(3), np.array([0, 0, 1.0]))
    _, deep = both(field, Camera("view", 1, 1, 20.0, 20.0, 0.5, 0.5, pose), 4)
    assert deep.counts[0, 0] == 4
    assert deep.z[0] == pytest.approx(3, abs=1e-4) and deep.z_back[-1] == pytest.approx(5, abs=1e-4)
    np.testing.assert_allclose(deep.z[1:], deep.z_back[:-1], atol=1e-4)  # no gaps


def test_the_same_bits_with_any_batches():
    field = field_of(BOX, 1, vm_color(2))
    found = []
    for size in (7, 117):
        deep = DeepCollector(field, CAMERA, 4, 2)
        render_view(field, CAMERA, threads=2, rays_at_once=size, on_rendered=deep.add)
        found.append(deep.view())
    for name in ("counts", "z", "z_back", "rgb", "weights"):
        assert np.array_equal(getattr(found[0], name), getattr(found[1], name)), name


def cube_through(points: np.ndarray, center: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Whether rays through (X/Z, Y/Z) [n, 2] hit the cube -1..1, by slabs."""
    directions = np.column_stack([points, np.ones(len(points))]) @ rotation.T
    with np.errstate(divide="ignore"):
        a, b = (-1 - center) / directions, (1 - center) / directions
    return np.minimum(a, b).max(1) < np.maximum(a, b).min(1)


def test_a_cube_rendered_through_a_lens_lies_on_its_photo():
    """The photo: rays that COLMAP casts, eight by eight a pixel, against the cube's slabs."""
    import pycolmap

    width, height, fine = 96, 72, 8
    params = [80.0, 82.0, 49.0, 35.0, -0.25, 0.06, 0.004, -0.003]
    intrinsics, lens = from_colmap("OPENCV", params)
    pose = look_at(np.array([3.4, 1.9, 1.4]), np.zeros(3), np.array([0, 0, 1.0]))
    plate = LensCamera("view", width, height, *intrinsics, pose, lens)
    field = field_of(BOX, 1, hash_color(2), step=1 / 200)
    field.density = density(0, size=(2, 2, 2))
    field.density.values[:-1], field.density.values[-1] = 0, 12
    seen = render_view(field, plate, threads=2).alpha > 0.5
    rows, columns = (np.mgrid[0 : height * fine, 0 : width * fine] + 0.5) / fine
    colmap = pycolmap.Camera(model="OPENCV", width=width, height=height, params=params)
    rays = np.asarray(colmap.cam_from_img(np.stack([columns, rows], -1).reshape(-1, 2)))[:, :2]
    photo = cube_through(rays, pose[:3, 3], pose[:3, :3]).reshape(height * fine, width * fine)
    distance = np.maximum(distance_transform_edt(photo), distance_transform_edt(~photo)) / fine
    at_centers = slice(fine // 2, None, fine)
    wrong = seen != photo[at_centers, at_centers]
    assert 800 < seen.sum() < 0.8 * seen.size
    assert distance[at_centers, at_centers][wrong].max(initial=0) < 0.5
    # And not by luck: the pinhole of the same intrinsics misses by more than a pixel.
    pinhole = Camera("view", width, height, *intrinsics, pose)
    straight = render_view(field, pinhole, threads=2).alpha > 0.5
    missed = straight != photo[at_centers, at_centers]
    assert distance[at_centers, at_centers][missed].max() > 1.2
