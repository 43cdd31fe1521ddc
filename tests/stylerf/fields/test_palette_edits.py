"""Changes of a palette by hand numbers."""

import json

import numpy as np
import pytest

from stylerf.errors import InvalidValue
from stylerf.fields.palette_edits import PaletteEdits, tinted

WEIGHTS = np.array([[0.5, 0.3, 0.2], [0.0, 1.0, 0.0]], np.float32)


def test_weights_are_scaled_shifted_cut_at_zero_and_brought_back_to_one():
    changed = PaletteEdits(scales={0: 0.5}, biases={2: -0.3, 1: 0.25}).weights(WEIGHTS)
    # 0.25, 0.55, max(-0.1, 0): sum 0.8; and 0, 1.25, 0.
    np.testing.assert_allclose(changed, [[0.3125, 0.6875, 0], [0, 1, 0]], rtol=1e-6)


def test_a_row_that_loses_everything_stays_as_it_was():
    changed = PaletteEdits(scales={1: 0.0}).weights(WEIGHTS)
    np.testing.assert_allclose(changed, [[5 / 7, 0, 2 / 7], [0, 1, 0]], rtol=1e-6)


def test_colors_are_replaced_and_the_others_kept():
    palette = np.arange(9, dtype=np.float32).reshape(3, 3) / 10
    changed = PaletteEdits(colors={1: (1.5, 0, -0.5)}).palette(palette)
    np.testing.assert_allclose(changed, [palette[0], [1.5, 0, -0.5], palette[2]])
    assert palette[1, 0] == np.float32(0.3)


@pytest.mark.parametrize("name", ["colors", "scales", "biases"])
def test_a_color_that_does_not_exist_is_named_with_those_that_do(name):
    edits = PaletteEdits(**{name: {7: (0, 0, 0) if name == "colors" else 1.0}})
    for count, exist in ((5, "0 to 4"), (1, "0 alone")):
        with pytest.raises(InvalidValue, match=f"palette color 7 does not exist; there are {exist}"):
            edits.check(count)
    with pytest.raises(InvalidValue, match="color -1 does not"):
        PaletteEdits(scales={-1: 1.0}).weights(WEIGHTS)


def test_nonsense_is_refused():
    for wrong in ({"scales": {0: float("nan")}}, {"colors": {0: (0, 1)}}, {"colors": {0: (0, 1, float("inf"))}}):
        with pytest.raises(InvalidValue, match="palette color 0"):
            PaletteEdits(**wrong)


def test_go_through_json():
    edits = PaletteEdits({1: (0.1, 0.2, 0.3)}, {0: 2.0}, {3: -0.5})
    assert PaletteEdits.restore(json.loads(json.dumps(edits.describe()))) == edits
    assert edits and not PaletteEdits()


def test_a_tint_keeps_lights_and_darks_about_their_mean():
    palette = np.array([[0.8, 0.8, 0.8], [0.4, 0.4, 0.4], [0.0, 0.0, 0.0]])
    found = tinted(palette, np.array([0.5, 0.5, 0.0]), (0.5, 0.2, 0.1))
    # The mean luma is 0.6: 4/3 and 2/3 of the target, and black.
    np.testing.assert_allclose(found, [[2 / 3, 0.8 / 3, 0.4 / 3], [1 / 3, 0.4 / 3, 0.2 / 3], [0, 0, 0]], rtol=1e-6)
    assert tinted(palette, np.array([0.1, 0.9, 0.0]), (0.9, 0.9, 0.9)).max() == 1.0  # cut, not wrapped
    assert np.isfinite(tinted(palette[2:], np.array([1.0]), (0.5, 0.5, 0.5))).all()
