"""Speckle of pictures and noise whose speckle is known."""

import numpy as np
import pytest
from scipy.integrate import quad, trapezoid
from scipy.stats import norm

from stylerf.errors import InvalidValue
from stylerf.metrics.speckle import speckle


def test_single_odd_pixels_count_by_the_square_of_their_height():
    image = np.full((42, 52, 3), 0.5)
    for row, column, height in ((5, 5, 0.3), (20, 30, -0.2), (30, 8, 0.4)):
        image[row, column] += height
    assert speckle(image) == pytest.approx(np.sqrt((0.09 + 0.04 + 0.16) / (40 * 50)))
    image[20, 30] = 0.5 + np.array([0.2, 0, 0])
    assert speckle(image) == pytest.approx(np.sqrt((0.09 + 0.04 / 3 + 0.16) / (40 * 50)))


def test_lines_edges_and_gradients_are_no_speckle():
    rows, columns = np.mgrid[:40, :60] / 60
    pictures = [rows + columns, rows > 0.3, np.abs(rows - columns) < 0.009, np.round(rows * 60) == 20]
    for gray in pictures:
        assert speckle(np.repeat(gray[..., None].astype(float), 3, -1)) == 0


def test_white_noise_has_what_order_statistics_say():
    """E[(X9 - X8)^2] / 9 for each of maximum and minimum, with X the sorted values of 9 normal ones."""
    # P(gap > g): any of the 9 is the largest, x, and all others are below x - g.
    gaps = np.linspace(0, 6, 301)
    tail = [quad(lambda x, g=g: 9 * norm.pdf(x) * norm.cdf(x - g) ** 8, -8, 8)[0] for g in gaps]
    second_moment = trapezoid(2 * gaps * np.array(tail), gaps)  # E[g^2]
    expected = np.sqrt(2 * second_moment / 9)
    noise = np.random.default_rng(0).standard_normal((400, 400, 3))
    assert speckle(0.5 + 0.05 * noise) == pytest.approx(0.05 * expected, rel=0.02)
    assert expected == pytest.approx(0.34, abs=0.005)  # as the docstring says


def test_only_pixels_whose_neighbors_all_count_do():
    image = np.full((30, 30, 3), 0.5)
    image[10, 10] = 1
    mask = np.ones((30, 30), bool)
    assert speckle(image, mask) == speckle(image) > 0
    mask[11, 11] = False
    assert speckle(image, mask) == 0


def test_what_cannot_be_measured_is_refused():
    with pytest.raises(InvalidValue, match="no pixel"):
        speckle(np.zeros((2, 2, 3)))
    with pytest.raises(InvalidValue, match="not finite"):
        speckle(np.full((9, 9, 3), np.nan))
    with pytest.raises(InvalidValue, match=r"expected an image \[h, w, 3\]"):
        speckle(np.zeros((9, 9)))
