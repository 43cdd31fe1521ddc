"""How a space's sides share the vertices of a grid."""

import numpy as np
import pytest

from stylerf.geometry.space_warp import SpaceWarp


def test_views_of_a_captures_own_cameras_start_at_near_and_others_at_the_near_plane():
    space = SpaceWarp.frustum(1.0, 1.0, 2.0, 1e3)
    assert [space.view_start(np.array([5.0, 5.0, z])) for z in (-3.0, 0.1, 0.5)] == [2, 2, 2]
    assert [space.view_start(np.array([5.0, 5.0, z])) for z in (0.6, 1.5, 4.0)] == pytest.approx([1.4, 0.5, 0.002])
    box = SpaceWarp.box((0, 0, 0), (4, 1, 2), near=0.5, kind="contraction")
    assert box.view_start(np.array([0.0, 0.0, 9.0])) == 0.5


def test_a_long_box_has_most_of_its_vertices_along_its_length():
    np.testing.assert_array_equal(SpaceWarp.box((0, 0, 0), (4, 1, 2)).cells_per_axis(64), [128, 32, 64])


def test_a_contraction_has_as_many_vertices_along_every_side():
    space = SpaceWarp.box((-1, -1, -1), (1, 3, 1), kind="contraction")
    np.testing.assert_array_equal(space.cells_per_axis(64), [64, 64, 64])


def test_a_frustum_tells_depths_apart_as_finely_as_views_do():
    """Twice as wide as high; the nearest point moves by half the width between the views: half as many depths."""
    found = SpaceWarp.frustum(1.0, 0.5, 1.0, 1e3, parallax=1.0).cells_per_axis(128)
    np.testing.assert_allclose(found, 128 * 2 ** (1 / 3) * np.array([1.0, 0.5, 0.5]) * 2 ** (1 / 3), atol=0.5)
    assert np.prod(found) == pytest.approx(128**3, rel=0.02)


def test_colors_of_a_frustum_are_finer_across_than_in_depth_and_those_of_a_box_as_its_density():
    space = SpaceWarp.frustum(1.0, 0.5, 1.0, 1e3, parallax=1.0)
    across = space.color_cells(128) / space.cells_per_axis(128)
    np.testing.assert_allclose(across, [4 / 3, 4 / 3, 1 / 2], rtol=0.01)
    assert space.color_cells(8).min() == 8
    box = SpaceWarp.box((0, 0, 0), (4, 1, 2))
    np.testing.assert_array_equal(box.color_cells(64), box.cells_per_axis(64))


def test_a_frustum_is_marched_in_steps_of_one_and_a_half_cells_and_other_spaces_cell_by_cell():
    box = SpaceWarp.box((0, 0, 0), (4, 1, 2))
    contraction = SpaceWarp.box((-1, -1, -1), (1, 3, 1), kind="contraction")
    frustum = SpaceWarp.frustum(1.0, 0.5, 1.0, 1e3)
    assert [64 * space.marching_step(64) for space in (box, contraction, frustum)] == [1, 1, 1.5]


@pytest.mark.parametrize(("parallax", "share"), [(0.01, 0.25), (9.0, 1.0)])
def test_depths_are_a_quarter_of_the_width_at_least_and_no_more_than_it(parallax, share):
    wide, _, deep = SpaceWarp.frustum(1.0, 0.5, 1.0, 1e3, parallax=parallax).cells_per_axis(96)
    assert deep == pytest.approx(share * wide, abs=0.6)


def test_unknown_parallax_gives_an_even_frustum_and_no_point_moves():
    even, uneven = (SpaceWarp.frustum(0.9, 0.6, 1.0, 1e3, parallax=p) for p in (0.0, 0.4))
    np.testing.assert_array_equal(even.cells_per_axis(50), [50, 50, 50])
    points = np.random.default_rng(0).uniform((-1, -1, 1), (1, 1, 9), (50, 3))
    np.testing.assert_array_equal(even.warp(points), uneven.warp(points))
    assert SpaceWarp.restore(uneven.describe()) == uneven
