"""Depth errors and palette distance against values worked out by hand."""

import numpy as np
import pytest

from stylerf.errors import InvalidValue
from stylerf.metrics.depth import depth_errors, shape_change
from stylerf.metrics.frechet import palette_distance


def test_depth_errors_of_four_pixels():
    z = np.array([[2.0, 3.0, 9.0, 5.0, np.nan]])
    alpha = np.array([[1.0, 1.0, 1.0, 0.2, 0.0]])
    truth = np.array([[2.0, 2.0, 1e10, 5.0, 5.0]])
    errors = depth_errors(z, alpha, truth)
    assert errors.pixels == 2  # the third has no surface, the last two are not opaque
    assert errors.share == pytest.approx(2 / 4)
    assert errors.abs_rel == pytest.approx((0 + 0.5) / 2)
    assert errors.rmse == pytest.approx(np.sqrt(0.5))
    assert errors.delta == pytest.approx(0.5)
    assert errors.in_front == 0
    assert depth_errors(z * 0.5, alpha, truth).in_front == 1.0


def test_depth_without_anything_to_compare_is_none_and_nan_is_refused():
    ones = np.ones((3, 3))
    assert depth_errors(ones, ones, np.full((3, 3), np.inf)).abs_rel is None
    with pytest.raises(InvalidValue, match="not finite"):
        depth_errors(np.full((3, 3), np.nan), ones, ones)


def test_shape_change_is_relative_to_the_base():
    ones = np.ones((2, 2))
    assert shape_change(ones * 2.2, ones, ones * 2, ones) == pytest.approx(0.1)
    assert shape_change(ones, ones * 0, ones, ones) is None


def test_palette_distance_of_shifted_and_scaled_colors():
    random = np.random.default_rng(0)
    colors = random.random((5000, 3))
    assert palette_distance(colors, colors[::-1]).frechet == pytest.approx(0, abs=1e-6)
    shifted = palette_distance(colors, colors + [0.3, 0.0, 0.4])
    assert shifted.mean == pytest.approx(0.5) and shifted.frechet == pytest.approx(0.5)
    assert shifted.covariance == pytest.approx(0, abs=1e-12)
    # Scaling by s about the mean: the covariance grows by s^2; frechet^2 = (s - 1)^2 tr S.
    center, covariance = colors.mean(axis=0), np.cov(colors.T, bias=True)
    scaled = palette_distance(colors, center + 3 * (colors - center))
    assert scaled.covariance == pytest.approx(8 * np.linalg.norm(covariance))
    assert scaled.frechet == pytest.approx(2 * np.sqrt(np.trace(covariance)))


def test_palette_refuses_what_is_no_color():
    with pytest.raises(InvalidValue):
        palette_distance(np.zeros((4, 4)), np.zeros((4, 3)))
    with pytest.raises(InvalidValue):
        palette_distance(np.full((4, 3), np.nan), np.zeros((4, 3)))
