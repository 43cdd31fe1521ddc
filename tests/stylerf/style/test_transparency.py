"""What a style image hides has no part in its features and colors."""

import numpy as np
import pytest
import torch

from stylerf.errors import InvalidValue
from stylerf.style.color_matching import in_colors_of
from stylerf.style.style_features import style_features
from stylerf.style.style_loss import StyleObjective, StyleWeights
from stylerf.style.transparency import shown_colors, without_hidden_colors
from tests.stylerf.style.small_trunk import picture, small_trunk


def cutout(hidden: float) -> np.ndarray:
    """A picture of 40x60 whose right third, a corner and a pixel are transparent, and of color `hidden` there."""
    pixels = np.concatenate([picture(40, 60, 3).permute(1, 2, 0).numpy(), np.ones((40, 60, 1), np.float32)], axis=2)
    for part in ((slice(None), slice(40, None)), (slice(0, 10), slice(0, 10)), (20, 20)):
        pixels[part] = (hidden, 1 - hidden, hidden, 0.2)
    return pixels


def test_garbage_below_transparent_pixels_changes_no_bit():
    one, other = (without_hidden_colors(cutout(hidden)) for hidden in (0.0, 0.9))
    assert one.shape == (40, 40, 4) and np.array_equal(one, other)


def test_shown_pixels_keep_their_colors_and_hidden_ones_take_the_nearest():
    found, given = without_hidden_colors(cutout(0.7)), cutout(0.7)[:, :40]
    shown = given[..., 3] == 1
    assert np.array_equal(found[..., 3] == 1, shown)
    assert np.array_equal(found[shown], given[shown])
    assert any(np.array_equal(found[20, 20, :3], given[at][:3]) for at in ((19, 20), (21, 20), (20, 19), (20, 21)))


def test_opaque_images_lose_their_alpha_and_empty_ones_are_refused():
    pixels = cutout(0.5)
    pixels[..., 3] = 0.9
    assert np.array_equal(without_hidden_colors(pixels), pixels[..., :3])
    with pytest.raises(InvalidValue, match="transparent everywhere"):
        without_hidden_colors(np.zeros((20, 20, 4), np.float32))


def test_color_statistics_are_those_of_shown_pixels():
    image = torch.from_numpy(without_hidden_colors(cutout(0.0))).permute(2, 0, 1)
    wanted = cutout(0.0)[:, :40][cutout(0.0)[:, :40, 3] == 1][:, :3]
    found = shown_colors(image).flatten(1).T.numpy()
    assert np.array_equal(found, wanted)
    scene = picture(30, 30, 8).flatten(1).T * 0.3 + 0.2
    matched = in_colors_of(image, scene)
    assert torch.equal(matched[3], image[3])
    np.testing.assert_allclose(shown_colors(matched).flatten(1).mean(1), scene.mean(0), atol=1e-5)


def test_features_are_of_shown_positions_alone():
    """Far from the edge of a cutout, its features are those of the whole picture; beyond it there are none."""
    whole = picture(64, 64, 4)
    image = torch.cat([whole, torch.zeros(1, 64, 64)])
    image[3, :, :32] = 1
    extractor = small_trunk("conv1_2,conv2_2")
    found, all_of_it = style_features(extractor, image), style_features(extractor, whole)
    for block, feature in all_of_it.items():
        half = feature[:, :, : feature.shape[2] // 2].flatten(1)
        assert torch.equal(found[block].flatten(1), half), block


def test_parts_too_small_for_a_feature_are_refused():
    image = torch.cat([picture(32, 32, 4), torch.zeros(1, 32, 32)])
    image[3, ::8, ::8] = 1
    with pytest.raises(InvalidValue, match="opaque parts are smaller"):
        style_features(small_trunk(), image)


def test_parts_too_small_for_deep_features_are_matched_by_shallow_ones():
    image = torch.cat([picture(64, 64, 4), torch.zeros(1, 64, 64)])
    image[3, 20:28, 20:28] = 1
    extractor = small_trunk("conv1_2,conv2_2")
    assert list(style_features(extractor, image)) == ["conv1"]
    objective = StyleObjective(extractor, image, (64, 64), StyleWeights(1, 1, 0, 0), scale=1.0, style_scale=1.0)
    photo = picture(64, 64, 5)
    loss, parts = objective(picture(64, 64, 6), objective.content_of(photo))
    shallow = StyleObjective(
        small_trunk("conv1_2"), image, (64, 64), StyleWeights(1, 1, 0, 0), scale=1.0, style_scale=1.0
    )
    assert float(loss) == pytest.approx(float(shallow(picture(64, 64, 6), shallow.content_of(photo))[0]), rel=1e-5)
    assert parts["style"] > 0
