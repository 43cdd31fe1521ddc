"""Paintings with a fault: each has the property it is named after, and the ordinary one has not."""

import numpy as np
import pytest

from stylerf.corruption import style_images

SIDE = 96
MAKERS = {
    "ordinary": style_images.ordinary,
    "tiny": style_images.tiny,
    "huge": style_images.huge,
    "wash": style_images.weak_geometry,
    "extreme": style_images.extreme_palette,
}


def steepest(picture: np.ndarray) -> float:
    """Largest difference of neighbors, sRGB."""
    return max(float(np.abs(np.diff(picture, axis=axis)).max()) for axis in (0, 1))


@pytest.mark.parametrize("name", MAKERS)
def test_size_range_and_seed(name):
    side = 4 if name == "tiny" else SIDE
    one, again, other = (MAKERS[name](side, seed) for seed in (1, 1, 2))
    assert one.shape == (side, side, 3) and one.dtype == np.float32 and 0 <= one.min() <= one.max() <= 1
    np.testing.assert_array_equal(one, again)
    assert np.abs(one - other).mean() > 0.01


def test_white_has_no_spread():
    assert np.ptp(style_images.white(20)) == 0 and style_images.white(20).min() == 1


def test_a_wash_has_colors_and_no_edge():
    wash, ordinary = style_images.weak_geometry(SIDE, 0), style_images.ordinary(SIDE, 0)
    assert steepest(wash) < 0.06 and steepest(ordinary) > 0.2
    assert wash.std((0, 1)).min() > 0.05  # colors there are


def test_an_extreme_palette_is_on_corners_in_equal_parts():
    picture = style_images.extreme_palette(SIDE, 0)
    assert {*map(tuple, picture.reshape(-1, 3).tolist())} == {style_images.RED, style_images.BLUE}
    assert picture[..., 0].mean() == pytest.approx(0.5, abs=0.01) and steepest(picture) == 1


def test_a_tiny_one_is_the_mean_of_the_large_one():
    large = style_images.ordinary(128, 3).astype(np.float64)
    tiny = style_images.tiny(8, 3)
    np.testing.assert_allclose(tiny[0, 0], large[:16, :16].mean((0, 1)), atol=1e-6)
    np.testing.assert_allclose(tiny.mean((0, 1)), large.mean((0, 1)), atol=1e-6)


def test_a_huge_one_is_smooth_but_for_its_grain():
    huge = style_images.huge(512, 0)
    blocks = huge.reshape(128, 4, 128, 4, 3).mean((1, 3))
    assert np.abs(blocks - style_images.ordinary(128, 0)).mean() < 0.06
    grain = huge - np.roll(huge, 1, axis=1)
    assert 0.01 < np.median(np.abs(grain)) < 0.05
