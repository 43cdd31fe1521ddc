"""Features of a style image: its strokes' size, its rotations, its parts."""

import numpy as np
import pytest
import torch

from stylerf.style import style_features as module
from stylerf.style.style_features import mirrored, stroke_picture, style_features
from stylerf.style.style_loss import StyleWeights, TransportObjective
from tests.stylerf.style.small_trunk import picture, small_trunk


def stripes(side: int, wavelength: float) -> torch.Tensor:
    wave = 0.5 + 0.4 * torch.sin(2 * torch.pi * torch.arange(side) / wavelength)
    return wave.expand(3, side, side).contiguous()


def wavelength_of(image: torch.Tensor) -> float:
    """Dominant wavelength along columns, pixels: the largest peak of the mean power spectrum, interpolated by zeros."""
    luma = image.mean(0).double().numpy()
    luma = (luma - luma.mean()) * np.hanning(luma.shape[1])
    power = (np.abs(np.fft.rfft(luma, 4096, axis=1)) ** 2).mean(0)
    return 4096 / (1 + int(np.argmax(power[1:])))


@pytest.mark.parametrize("stroke", [0.25, 0.5, 1.0, 2.0, 4.0])
def test_strokes_are_as_many_times_as_large(stroke):
    style = stripes(96, 12.0)
    plain, found = wavelength_of(stroke_picture(style, 192)), wavelength_of(stroke_picture(style, 192, stroke))
    assert plain == pytest.approx(24, rel=0.03)
    assert found == pytest.approx(24 * stroke, rel=0.07)  # where mirror images meet, the phase turns


def test_small_strokes_fill_the_same_area_without_a_seam():
    found = stroke_picture(picture(30, 40, 1), 80, 0.5)
    assert found.shape == (3, 60, 80)
    assert torch.equal(found, mirrored(picture(30, 40, 1), 60, 80))
    for axis in (1, 2):
        assert torch.equal(found, found.flip(axis))  # a picture and its mirror image


def test_the_default_is_the_whole_image_at_its_old_size():
    extractor, style = small_trunk(), picture(30, 40, 1)
    found = style_features(extractor, stroke_picture(style, 40))
    first, *second = extractor(style[None])
    for block, feature in {"conv1": first, "conv2": torch.cat(second, 1)}.items():
        assert torch.equal(found[block], feature[0])


def test_parts_have_the_features_of_the_whole_image(monkeypatch):
    monkeypatch.setattr(module, "PART_SIDE", 24)
    extractor, style = small_trunk(), picture(52, 76, 2)
    whole, parts = style_features(extractor, style), style_features(extractor, style, in_parts=True)
    for block, feature in whole.items():
        wanted, found = (one.flatten(1).T.double().numpy() for one in (feature, parts[block]))
        assert len(wanted) == len(found), block
        # The same rows, in another order.
        np.testing.assert_allclose(found[np.lexsort(found.T)], wanted[np.lexsort(wanted.T)], atol=1e-5)


def test_parts_of_a_large_image_are_spread_over_it_and_bounded(monkeypatch):
    monkeypatch.setattr(module, "PART_SIDE", 24)
    monkeypatch.setattr(module, "MOST_PIXELS", 96 * 96 // 4)
    monkeypatch.setattr(module, "MOST_POSITIONS", 320)
    ramp = torch.linspace(0, 1, 96).expand(3, 96, 96).contiguous()
    extractor = small_trunk("conv1_2")
    (whole,), (found,) = (style_features(extractor, ramp, in_parts=in_parts).values() for in_parts in (False, True))
    assert found.shape[1:] == (1, 320)
    assert float(found.mean()) == pytest.approx(float(whole.mean()), rel=0.05)


def test_rotations_are_those_of_the_image():
    extractor, style = small_trunk("conv1_2"), picture(20, 28, 5)
    (found,) = style_features(extractor, style, rotations=True).values()
    wanted = [extractor(style.rot90(turn, (1, 2))[None])[0][0].flatten(1) for turn in range(4)]
    assert torch.equal(found[:, 0], torch.cat(wanted, 1))


def test_a_turned_view_matches_as_well_as_the_view_with_rotations_only():
    style = stripes(48, 8.0)

    def distance(rotations: bool, image: torch.Tensor) -> float:
        objective = TransportObjective(
            small_trunk("conv2_1"), style, (48, 48), StyleWeights(), scale=1.0, rotations=rotations
        )
        return objective(image, None)[1]["style"]

    straight, turned = style, style.rot90(1, (1, 2)).contiguous()
    assert distance(False, turned) > distance(False, straight) + 0.02
    assert distance(True, turned) == pytest.approx(distance(True, straight), abs=0.005)


def test_rows_per_step_do_not_grow_with_strokes_or_rotations():
    for more in ({"strokes": (4.0,)}, {"strokes": (0.25,)}, {"rotations": True}):
        objective = TransportObjective(
            small_trunk("conv1_2"), picture(80, 80, 1), (80, 80), StyleWeights(), scale=1.0, most_rows=500, **more
        )
        assert len(objective.styles[0]["conv1"].rows.rows) == 500, more
