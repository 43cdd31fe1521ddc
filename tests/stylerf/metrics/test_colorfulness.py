"""Colorfulness of known images."""

import numpy as np
import pytest

from stylerf.errors import InvalidValue
from stylerf.metrics.colorfulness import colorfulness


def test_grays_have_none_and_fading_lowers_it_in_proportion():
    generator = np.random.default_rng(0)
    grays = np.repeat(generator.random((50, 1)), 3, axis=1)
    colors = generator.random((50, 3))
    assert colorfulness(grays) == pytest.approx(0, abs=1e-12)
    assert colorfulness(0.5 + (colors - 0.5) / 4) == pytest.approx(colorfulness(colors) / 4)


def test_known_colors():
    # Red and green: R - G is 1 and -1, (R + G) / 2 - B is 0.5 for both.
    assert colorfulness(np.array([[1.0, 0, 0], [0, 1, 0]])) == pytest.approx(1 + 0.3 * 0.5)


@pytest.mark.parametrize("wrong", [np.zeros((0, 3)), np.zeros((4, 2)), np.full((4, 3), np.nan)])
def test_what_is_no_set_of_colors_is_refused(wrong):
    with pytest.raises(InvalidValue, match="expected finite colors"):
        colorfulness(wrong)
