"""A photo painted in 2D comes nearer to the style image, and what is around an object stays."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from stylerf.errors import InvalidValue
from stylerf.metrics.frechet import palette_distance
from stylerf.style.style_loss import StyleWeights
from stylerf.training.stylize.arf import OBJECTIVES
from stylerf.training.stylize.painted_photo import painted_photo
from stylerf.training.stylize.settings import ImageStyleSettings
from tests.stylerf.style.small_trunk import small_trunk

SETTINGS = ImageStyleSettings(
    weights=StyleWeights(1.0, 0.001, 0.0, 0.1), loss="gram", feature_scale=1.0, coarse=0.5, match="none"
)


@pytest.fixture(scope="module")
def photo():
    rows, columns = np.mgrid[:40, :56]
    gray = 0.5 + 0.3 * np.sin(rows / 9) * np.cos(columns / 11)
    return np.stack([gray, 0.5 + 0.3 * np.cos(rows / 7), 0.5 + 0.3 * np.sin(columns / 5)], axis=-1).astype(np.float32)


@pytest.fixture(scope="module")
def stripes():
    columns = torch.arange(60)
    stripe = ((columns // 3) % 2).float().expand(48, 60)
    return torch.stack([0.1 + 0.7 * stripe, 0.3 + 0.2 * stripe, 0.9 - 0.8 * stripe])


def gram_distance(image: np.ndarray, style: torch.Tensor) -> float:
    loss = OBJECTIVES["gram"](small_trunk(), style, image.shape[:2], StyleWeights(1, 0, 0, 0), 1.0)
    return loss(torch.from_numpy(image).permute(2, 0, 1), None)[1]["style"]


def test_it_comes_nearer_to_the_style_image_with_more_steps(photo, stripes):
    few, many = (painted_photo(photo, None, 1.0, stripes, SETTINGS, small_trunk(), steps) for steps in (2, 40))
    distances = [gram_distance(image, stripes) for image in (photo, few, many)]
    assert distances[2] < min(distances[:2]) / 2
    assert many.shape == photo.shape and many.dtype == np.float32 and 0 <= many.min() <= many.max() <= 1
    assert np.array_equal(few, painted_photo(photo, None, 1.0, stripes, SETTINGS, small_trunk(), 2))


@pytest.mark.parametrize("option", [{"stroke": 2.0}, {"rotations": True}])
def test_strokes_are_as_the_settings_say(photo, stripes, option):
    plain, other = (
        painted_photo(photo, None, 1.0, stripes, settings, small_trunk(), 10)
        for settings in (SETTINGS, replace(SETTINGS, **option))
    )
    assert np.abs(plain - other).mean() > 1e-3


def test_deep_layers_are_used_in_the_coarse_steps_only(photo, stripes):
    """Without coarse steps, leaving a layer out is the same as an extractor without it."""
    settings = replace(SETTINGS, coarse=0.0)
    extractor = small_trunk("conv1_2,conv2_1")
    less = painted_photo(photo, None, 1.0, stripes, replace(settings, fine_layers="conv1_2"), extractor, 3)
    assert np.array_equal(less, painted_photo(photo, None, 1.0, stripes, settings, small_trunk("conv1_2"), 3))
    assert not np.array_equal(less, painted_photo(photo, None, 1.0, stripes, settings, extractor, 3))


@pytest.mark.parametrize("match", ["before", "after", "both"])
def test_colors_are_matched_as_the_settings_say(photo, stripes, match):
    settings = replace(SETTINGS, match=match, max_gain=0.0)
    wanted = stripes.flatten(1).T.numpy()
    plain, matched = (
        palette_distance(
            painted_photo(photo, None, 1.0, stripes, one, small_trunk(), 2).reshape(-1, 3), wanted
        ).frechet
        for one in (SETTINGS, settings)
    )
    assert matched < plain / 2


def test_kept_colors_are_those_of_the_photo(photo, stripes):
    settings = replace(SETTINGS, match="after", keep_colors=True)
    found = painted_photo(photo, None, 1.0, stripes, settings, small_trunk(), 10)
    assert palette_distance(found.reshape(-1, 3), photo.reshape(-1, 3)).mean < 0.02


def test_what_is_around_an_object_stays(photo, stripes):
    mask = np.zeros(photo.shape[:2], bool)
    mask[10:30, 14:40] = True
    on_white = np.where(mask[..., None], photo, np.float32(1))
    found = painted_photo(on_white, mask, 1.0, stripes, replace(SETTINGS, match="both"), small_trunk(), 10)
    np.testing.assert_array_equal(found[~mask], 1)
    assert np.abs(found - on_white)[mask].mean() > 0.05


def test_nothing_to_paint_is_refused(photo, stripes):
    for mask, steps in ((None, 0), (np.zeros(photo.shape[:2], bool), 5)):
        with pytest.raises(InvalidValue, match="expected at least one step and an object"):
            painted_photo(photo, mask, 1.0, stripes, SETTINGS, small_trunk(), steps)
