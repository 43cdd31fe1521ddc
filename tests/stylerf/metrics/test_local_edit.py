"""Background MSE, ring and change against loops over pixels and color differences worked out by hand."""

import numpy as np
import pytest

from stylerf.errors import InvalidValue
from stylerf.metrics.local_edit import background_mse, mean_change, split_view

RANDOM = np.random.default_rng(3)
A, B = RANDOM.random((2, 13, 17, 3))


def blob() -> np.ndarray:
    inside = np.zeros((13, 17), bool)
    inside[4:7, 5:9], inside[6, 12] = True, True
    return inside


def test_background_mse_is_the_formula_pixel_by_pixel():
    mask = RANDOM.random((13, 17)) * (RANDOM.random((13, 17)) < 0.5)
    above, below = 0.0, 0.0
    for row in range(13):
        for column in range(17):
            m = 1 - mask[row, column]
            below += 3 * m
            for channel in range(3):
                above += m * (A[row, column, channel] - B[row, column, channel]) ** 2
    assert background_mse(A, B, mask) == pytest.approx(above / below, rel=1e-12)
    # What is edited does not count, however far it is from the photo.
    edited = np.where(blob()[..., None], 0.9, B)
    assert background_mse(edited, B, blob()) == 0 < background_mse(edited, B, np.zeros((13, 17)))


@pytest.mark.parametrize("mask", [np.ones((13, 17)), np.full((13, 17), -0.1), np.full((13, 17), 1.5), np.zeros((4, 4))])
def test_masks_without_background_or_sense_are_refused(mask):
    with pytest.raises(InvalidValue):
        background_mse(A, B, mask)


@pytest.mark.parametrize(("margin", "ring"), [(0, 1), (2, 3), (1.5, 0), (0, 0), (30, 5)])
def test_margin_and_ring_are_distances_to_the_nearest_pixel_of_the_region(margin, ring):
    found = split_view(blob(), margin, ring)
    places = np.argwhere(blob())
    for row in range(13):
        for column in range(17):
            nearest = min(np.hypot(row - r, column - c) for r, c in places)
            assert found.outside[row, column] == (nearest > margin)
            assert found.ring[row, column] == (margin < nearest <= margin + ring)
    assert np.array_equal(found.inside, blob())


def test_a_view_without_the_region_is_all_background():
    found = split_view(np.zeros((5, 6), bool), 2, 4)
    assert found.outside.all() and not found.ring.any() and not found.inside.any()
    assert mean_change(np.zeros((5, 6, 3)), np.ones((5, 6, 3)), found.inside) is None


def lab(rgb) -> np.ndarray:
    """IEC 61966-2-1 and CIE 15, a color at a time."""
    linear = [v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in rgb]
    rows = [(0.4124564, 0.3575761, 0.1804375), (0.2126729, 0.7151522, 0.0721750), (0.0193339, 0.1191920, 0.9503041)]
    white = (0.95047, 1.0, 1.08883)
    f = []
    for row, w in zip(rows, white, strict=True):
        t = sum(k * v for k, v in zip(row, linear, strict=True)) / w
        f.append(t ** (1 / 3) if t > (6 / 29) ** 3 else t / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def test_change_is_the_mean_over_the_pixels_requested():
    found = mean_change(A, B, blob())
    absolute, difference = [], []
    for row, column in np.argwhere(blob()):
        absolute += [abs(A[row, column, c] - B[row, column, c]) for c in range(3)]
        difference.append(np.sqrt(((lab(A[row, column]) - lab(B[row, column])) ** 2).sum()))
    assert found.absolute == pytest.approx(np.mean(absolute), rel=1e-12)
    assert found.lab == pytest.approx(
        np.mean(difference), rel=1e-3
    )  # tables of the sRGB matrix differ in the 4th digit
    white = mean_change(np.ones((2, 2, 3)), np.zeros((2, 2, 3)), np.ones((2, 2), bool))
    assert white.lab == pytest.approx(100, abs=1e-3) and white.absolute == 1


def test_what_is_not_finite_is_refused_where_it_is_looked_at():
    broken = A.copy()
    broken[5, 6, 1] = np.nan
    assert mean_change(broken, B, ~blob()) == mean_change(A, B, ~blob())
    with pytest.raises(InvalidValue):
        mean_change(broken, B, blob())
    with pytest.raises(InvalidValue):
        mean_change(A, B[:5], blob())
