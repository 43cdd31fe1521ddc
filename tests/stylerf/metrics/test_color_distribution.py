"""The distance of color distributions against closed forms."""

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment
from skimage.color import lab2rgb, rgb2lab

from stylerf.errors import InvalidValue
from stylerf.metrics.color_distribution import AXES, color_quantiles, distance_of_quantiles
from stylerf.metrics.frechet import palette_distance


def color_distance(a: np.ndarray, b: np.ndarray) -> float:
    return distance_of_quantiles(color_quantiles(a), color_quantiles(b))


def rgb_of(lab: np.ndarray) -> np.ndarray:
    return lab2rgb(lab[None])[0]


@pytest.fixture(scope="module")
def grayish():
    """Colors in CIELAB [2000, 3], all of them well inside sRGB."""
    return np.array([55.0, 0, 0]) + 4 * np.random.default_rng(0).standard_normal((2000, 3)).clip(-3, 3)


def test_an_image_has_no_distance_to_itself_in_any_order(grayish):
    colors = rgb_of(grayish)
    assert color_distance(colors, colors) == 0
    assert color_distance(colors, np.tile(colors[::-1], (3, 1))) == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("move", [(9.0, 0, 0), (0, -7, 0), (3, 4, -12)])
def test_a_shift_has_its_own_length(grayish, move):
    found = color_distance(rgb_of(grayish), rgb_of(grayish + move))
    assert found == pytest.approx(np.linalg.norm(move), abs=0.02)


def test_the_axes_favor_no_direction():
    np.testing.assert_allclose(AXES.T @ AXES, len(AXES) / 3 * np.eye(3), atol=1e-12)


def test_spreads_differ_as_those_of_isotropic_gaussians(grayish):
    """Their 2-Wasserstein distance is sqrt(3) |s1 - s2|, and scaling about the mean is the optimal map."""
    mean = grayish.mean(0)
    found = color_distance(rgb_of(grayish), rgb_of(mean + (grayish - mean) / 2))
    assert found == pytest.approx(np.sqrt(np.square((grayish - mean) / 2).sum(1).mean()), rel=0.01)


def test_it_is_within_its_bound_of_the_exact_distance():
    generator = np.random.default_rng(1)
    a, b = generator.random((150, 3)), generator.random((150, 3)) ** 2
    cost = np.square(rgb2lab(a[None])[0][:, None] - rgb2lab(b[None])[0][None]).sum(-1)
    exact = np.sqrt(cost[linear_sum_assignment(cost)].mean())
    assert 0.5 * exact < color_distance(a, b) <= np.sqrt(3) * exact


def test_it_sees_what_mean_and_covariance_leave_out():
    generator = np.random.default_rng(2)
    inks = np.array([[0.2, 0.3, 0.4], [0.8, 0.7, 0.6]])[generator.integers(0, 2, 4000)]
    blend = generator.multivariate_normal(inks.mean(0), np.cov(inks.T, bias=True), 4000)
    blend = (blend - blend.mean(0)) * inks.std(0) / blend.std(0) + inks.mean(0)
    assert palette_distance(inks, blend).frechet < 0.01
    assert color_distance(inks, np.clip(blend, 0, 1)) > 5


@pytest.mark.parametrize("wrong", [np.zeros((0, 3)), np.zeros((4, 2)), np.full((4, 3), np.nan)])
def test_what_is_no_set_of_colors_is_refused(wrong):
    with pytest.raises(InvalidValue, match="expected finite colors"):
        color_distance(wrong, np.zeros((2, 3)))
