"""Whole views: parts are the whole, depth is where the surface is."""

import numpy as np
import pytest

from stylerf.editing.selection import ends_of_rays
from stylerf.geometry.camera_paths import look_at
from stylerf.geometry.cameras import Camera
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.rendering.interlaced import render_pixels
from stylerf.rendering.view import render_view
from tests.stylerf.small import density, field_of, hash_color, vm_color, wall_in_front

BOX = SpaceWarp.box([-1, -1, -1], [1, 1, 1])


def camera(center=(2.6, 0.9, 0.7), width=13, height=9, focal=14.0) -> Camera:
    pose = look_at(np.array(center, float), np.zeros(3), np.array([0, 0, 1.0]))
    return Camera("view", width, height, focal, focal + 1, width / 2, height / 2, pose)


@pytest.mark.parametrize("color", [vm_color(2), hash_color(2)], ids=["vm", "hash"])
def test_shares_of_a_view_are_the_same_bits_as_the_whole(color):
    field, done = field_of(BOX, 1, color), []
    whole = render_view(field, camera(), threads=1)
    assert 0.2 < (whole.alpha > 0.5).mean() < 1
    for rays_at_once, threads in ((7, 1), (50, 3), (117, 2)):
        done.clear()
        found = render_view(field, camera(), threads=threads, rays_at_once=rays_at_once, on_rays=done.append)
        for name in ("rgb", "alpha", "ray_distance", "z"):
            assert np.array_equal(getattr(found, name), getattr(whole, name)), name
        assert done[-1] == 117 and done == sorted(done) and len(done) == -(-117 // rays_at_once)


def test_a_solid_box_has_its_front_as_a_plane_of_even_depth():
    step = 1 / 50
    field = field_of(BOX, 1, hash_color(2), step=step)
    field.density = density(0, size=(2, 2, 2))
    field.density.values[:-1], field.density.values[-1] = 0, 12
    seen = render_view(field, camera(center=(4.0, 0, 0), focal=20), threads=1)
    front = (np.abs(np.indices((9, 13))[1] + 0.5 - 6.5) / 20 * 3 < 0.99) & (
        np.abs(np.indices((9, 13))[0] + 0.5 - 4.5) / 21 * 3 < 0.99
    )
    assert 40 < front.sum() and np.array_equal(seen.alpha == 1, front)
    # The box's front is 3 away; a ray is asked first half a step (of a cube two units wide) behind it.
    np.testing.assert_allclose(seen.z[front], 3 + 0.5 * step * 2, rtol=1e-5)
    np.testing.assert_allclose(seen.ray_distance, seen.z / camera(focal=20).ray_cosines(), rtol=1e-6)
    assert not seen.z[~front].any() and not seen.rgb[~front].any()


def test_depth_in_fog_is_where_half_of_what_is_seen_lies():
    """Even fog that takes 1 - exp(-3 x) of the light on its first x of the cube: half of what all of it takes."""
    field = field_of(BOX, 1, hash_color(2), step=1 / 400)
    field.density = density(0, size=(2, 2, 2))
    field.density.values[:-1], field.density.values[-1] = 0, np.log(0.03)
    seen = render_view(field, camera(center=(4.0, 0, 0), width=1, height=1, focal=20), threads=1, min_transmittance=0.0)
    assert seen.alpha[0, 0] == pytest.approx(1 - np.exp(-3), rel=1e-4)
    assert seen.z[0, 0] == pytest.approx(3 - 2 / 3 * np.log((1 + np.exp(-3)) / 2), abs=0.02)


def along_the_axis(width=5, height=5, ahead: float = 0.0) -> Camera:
    pose = np.eye(4)
    pose[2, 3] = ahead
    return Camera("view", width, height, 40.0, 40.0, width / 2, height / 2, pose)


@pytest.mark.parametrize(("through", "backs", "z"), [(0.02, False, 3), (0.3, False, 3), (0.4, True, 3), (0.6, True, 6)])
def test_depth_is_that_of_a_surface_whatever_light_passes_it(through, backs, z):
    seen = render_view(wall_in_front(through, backs), along_the_axis(), threads=1)
    np.testing.assert_allclose(seen.alpha, 1, atol=1e-5)
    np.testing.assert_allclose(seen.z, z, rtol=0.05)


@pytest.mark.parametrize("ahead", [0.2, 0.7, 2.3, 2.8])
def test_a_camera_that_moves_into_a_frustum_still_sees_what_is_near(ahead):
    """The wall is at z = 3; `near`, where rays of the capture's own cameras start, is 1."""
    field, camera = wall_in_front(0.02), along_the_axis(ahead=ahead)
    seen = render_view(field, camera, threads=1)
    np.testing.assert_allclose(seen.z, 3 - ahead, atol=0.1)
    pixels = render_pixels(field, camera, np.arange(25), threads=1)
    np.testing.assert_array_equal(pixels[:, 4].reshape(5, 5), seen.ray_distance)
    ends, _ = ends_of_rays(field, camera, np.arange(25), 1)
    np.testing.assert_allclose(ends[:, 2], 2 / 3, atol=0.02)


def test_depth_of_what_nothing_stops_is_that_of_the_backdrop():
    seen = render_view(wall_in_front(0.8), along_the_axis(), threads=1)
    np.testing.assert_allclose(seen.ray_distance, 1e4, rtol=1e-5)
