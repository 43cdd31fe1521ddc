"""Strokes: seeds equally far apart along them, drawn where the pointer was."""

import numpy as np
import pytest

from stages.viewing.cameras import Pose
from stages.viewing.strokes import MOST_SEEDS, SPACING, drawn_at, seeds_along


def test_seeds_follow_the_stroke_at_equal_distances():
    corner = [(0.2, 0.2), (0.4, 0.2), (0.4, 0.5)]
    seeds = np.array(seeds_along(corner, 1.5))
    np.testing.assert_allclose(seeds[[0, -1]], [corner[0], corner[-1]])
    on_first = np.isclose(seeds[:, 1], 0.2) & (seeds[:, 0] <= 0.4 + 1e-9)
    on_second = np.isclose(seeds[:, 0], 0.4)
    assert (on_first | on_second).all() and on_first.sum() > 5 and on_second.sum() > 5
    steps = np.abs(np.diff(seeds * [1.5, 1.0], axis=0)).sum(1)  # around the corner too: the sum of both parts
    np.testing.assert_allclose(steps, 0.6 / (len(seeds) - 1), rtol=1e-6)
    assert steps[0] >= SPACING


def test_seeds_are_few_and_inside_the_picture():
    assert seeds_along([(0.5, 0.5)], 1.0) == [(0.5, 0.5)]
    assert seeds_along([(0.5, 0.5), (0.5, 0.5)], 1.0) == [(0.5, 0.5)]
    long = seeds_along([(x / 50, 0.1 * (x % 2)) for x in range(60)], 2.0)
    assert len(long) == MOST_SEEDS
    assert np.min(long) >= 0 and np.max(long) <= 1


def test_a_stroke_is_drawn_where_the_pointer_was():
    half = np.sqrt(0.5)
    pose = Pose((half, 0.0, half, 0.0), (1.0, 2.0, 3.0), 0.9, 1.6)
    way = [(0.1, 0.2), (0.5, 0.5), (0.9, 0.7)]
    camera = pose.camera(1_000_000)
    pixels, depth = camera.project(drawn_at(pose, way, 2.5))
    np.testing.assert_allclose(depth, 2.5, rtol=1e-6)
    np.testing.assert_allclose(pixels / [camera.width, camera.height], way, atol=2e-3)
    assert drawn_at(pose, [(0.5, 0.5)], 2.5)[0] == pytest.approx(pose.position + 2.5 * camera.forward)
