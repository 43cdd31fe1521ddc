"""Pictures of the still life against the rays that they are made of, and the cameras that see it."""

import numpy as np
import pytest

from stylerf.procedural.still_life import StillLife, dome_cameras

SIZE = 40
CAMERA = dome_cameras(3, SIZE, "view", 5)[1]
LIFE = StillLife()
VIEW = LIFE.render(CAMERA)


def hits(samples: int) -> np.ndarray:
    """[SIZE, SIZE] share of samples^2 rays through each pixel, evenly spread, that meet anything."""
    steps = (np.arange(SIZE * samples) + 0.5) / samples
    columns, rows = np.meshgrid(steps, steps)
    directions = CAMERA.unproject(np.stack([columns.ravel(), rows.ravel()], -1), np.ones(columns.size)) - CAMERA.center
    met = np.isfinite(LIFE.trace(CAMERA.center[None], directions))
    return met.reshape(SIZE, samples, SIZE, samples).mean(axis=(1, 3))


def test_depth_unprojects_onto_the_surfaces():
    rows, columns = np.nonzero(np.isfinite(VIEW.z))
    points = CAMERA.unproject(np.stack([columns + 0.5, rows + 0.5], -1), VIEW.z[rows, columns].astype(np.float64))
    assert len(rows) > 200
    assert np.abs(LIFE.distance(points)).max() < 1e-5  # float32 at a distance of four
    distances = np.linalg.norm(points - CAMERA.center, axis=1)
    np.testing.assert_allclose(VIEW.ray_distance[rows, columns], distances, rtol=1e-6)
    assert (np.isinf(VIEW.z) == np.isinf(VIEW.ray_distance)).all()


def test_coverage_is_the_share_of_a_pixel_that_is_covered():
    share, alpha = hits(8), VIEW.rgba[..., 3]
    # 16 rays a pixel where four differ: off by little on average, and by three rays at worst.
    assert np.abs(alpha - share).mean() < 0.01
    assert np.abs(alpha - share)[(share > 0) & (share < 1)].mean() < 0.07
    inside = (share == 1) & (alpha < 1)
    assert inside.sum() == 0
    assert (alpha[share == 0] == 0).all() and 0.1 < (share == 1).mean() < 0.9


def test_colors_are_those_of_light_things_and_dark_ones():
    rgb, solid = VIEW.rgba[..., :3], VIEW.rgba[..., 3] == 1
    assert VIEW.rgba.dtype == np.float32 and 0 <= VIEW.rgba.min() and VIEW.rgba.max() <= 1
    assert rgb[solid].std(0).min() > 0.08 and 0.2 < rgb[solid].mean() < 0.7
    assert len(np.unique((rgb[solid] * 8).astype(int), axis=0)) > 40  # several materials, shaded


def test_threads_change_nothing_and_the_seed_only_textures():
    again = LIFE.render(CAMERA, threads=2)
    np.testing.assert_array_equal(again.rgba, VIEW.rgba)
    other = StillLife(1).render(CAMERA)
    np.testing.assert_array_equal(other.z, VIEW.z)
    # Where rays of a pixel differ in color more of them are sent, so that a texture may refine a coverage.
    assert np.abs(other.rgba[..., 3] - VIEW.rgba[..., 3]).mean() < 1e-3
    assert np.abs(other.rgba[..., :3] - VIEW.rgba[..., :3]).mean() > 1e-3


def test_a_point_keeps_its_color_when_the_camera_turns():
    """Nothing is random from view to view: the same rays, from a camera half as wide, give the same pixels."""
    from dataclasses import replace

    right = replace(CAMERA, width=SIZE // 2, cx=CAMERA.cx - SIZE // 2)
    np.testing.assert_allclose(LIFE.render(right).rgba, VIEW.rgba[:, SIZE // 2 :], atol=1e-6)


def test_dome_cameras_look_at_the_origin_from_a_dome():
    cameras = dome_cameras(60, 100, "train", 0)
    eyes = np.array([camera.center for camera in cameras])
    np.testing.assert_allclose(np.linalg.norm(eyes, axis=1), 4.03, rtol=1e-12)
    elevation = np.degrees(np.arcsin(eyes[:, 2] / 4.03))
    assert elevation.min() > 10 and elevation.max() < 72
    for camera in cameras:
        pixels, depth = camera.project(np.zeros((1, 3)))
        np.testing.assert_allclose(pixels, [[50, 50]], atol=1e-9)
        assert depth[0] == pytest.approx(4.03)
        above, _ = camera.project(np.array([[0, 0, 0.5]]))
        assert above[0, 1] < 50 and above[0, 0] == pytest.approx(50)  # +z up in the picture
        assert 2 * np.arctan(50 / camera.fx) == pytest.approx(0.6911112)
    assert len({camera.name for camera in cameras}) == 60
    # Evenly spread: every quarter of the turn has its share, and neighbors keep apart.
    quarters = np.bincount(((np.arctan2(eyes[:, 1], eyes[:, 0]) + np.pi) // (np.pi / 2)).astype(int) % 4, minlength=4)
    assert quarters.min() >= 12
    gaps = np.linalg.norm(eyes[:, None] - eyes[None], axis=-1) + 9 * np.eye(60)
    assert gaps.min() > 0.25


def test_dome_cameras_follow_from_their_seed():
    one, same, other = (dome_cameras(5, 32, "a", seed) for seed in (0, 0, 1))
    np.testing.assert_array_equal([c.world_from_camera for c in one], [c.world_from_camera for c in same])
    assert np.abs(one[0].center - other[0].center).max() > 0.1
