"""Feed-forward references: statistics of features, the decoder as a chain, and the real weights where they are."""

import numpy as np
import pytest
import torch
from torch import nn

from stages.weights.sources import wct_decoder
from stylerf.style.feature_extractor import FeatureExtractor, resized
from stylerf.style.image_stylization import Decoder, ImageOptimization, adain, adain_picture, painted
from tests.stylerf.style.small_trunk import picture


def decoder_file(seed: int = 0) -> dict[str, torch.Tensor]:
    """As the published file names its layers; few channels."""
    generator, found = torch.Generator().manual_seed(seed), {}
    for place, before, after in ((1, 6, 4), (5, 4, 4), (8, 4, 3), (12, 3, 3), (15, 3, 3)):
        found[f"{place}.weight"] = torch.randn(after, before, 3, 3, generator=generator) * 0.3
        found[f"{place}.bias"] = torch.randn(after, generator=generator) * 0.1
    return found


def test_the_decoder_is_the_published_chain():
    file = decoder_file()

    def convolution(place: int) -> nn.Conv2d:
        after, before = file[f"{place}.weight"].shape[:2]
        made = nn.Conv2d(before, after, 3)
        made.load_state_dict({part: file[f"{place}.{part}"] for part in ("weight", "bias")})
        return made

    pad, double = nn.ReflectionPad2d(1), nn.Upsample(scale_factor=2, mode="nearest")
    chain = nn.Sequential(pad, convolution(1), nn.ReLU(), double, pad, convolution(5), nn.ReLU(), pad, convolution(8),
                          nn.ReLU(), double, pad, convolution(12), nn.ReLU(), pad, convolution(15))  # fmt: skip
    features = torch.rand(1, 6, 5, 4, generator=torch.Generator().manual_seed(1))
    found = Decoder(wct_decoder(file))(features)
    assert found.shape == (1, 3, 20, 16) and torch.allclose(found, chain(features), atol=1e-6)


def test_features_take_the_statistics_of_the_painting():
    generator = torch.Generator().manual_seed(0)
    content, style = (torch.randn(1, 5, 9, 7, generator=generator) * s + m for s, m in ((1.0, 0.0), (3.0, 2.0)))
    found = adain(content, style).numpy()
    np.testing.assert_allclose(found.mean((2, 3)), style.numpy().mean((2, 3)), atol=1e-5)
    np.testing.assert_allclose(found.std((2, 3)), style.numpy().std((2, 3)), rtol=1e-4)
    # What was alike stays alike: a positive affine map of each channel.
    assert np.corrcoef(found[0, 2].ravel(), content.numpy()[0, 2].ravel())[0, 1] > 1 - 1e-6


@pytest.mark.realdata
def test_the_real_decoder_gives_a_photo_back_and_a_painting_changes_it(data_dir, monkeypatch, tmp_path):
    from stages.artifacts.style_images import read_style_image
    from stages.weights.resolve import resolve, resolve_decoder

    monkeypatch.setenv("STYLERF_WEIGHTS", str(data_dir / "weights"))
    monkeypatch.setenv("STYLERF_CACHE", str(tmp_path))
    found, decoder = resolve("vgg19-wct"), Decoder(resolve_decoder().state)
    trunk = FeatureExtractor(found.state, "conv3_1", found.kind)
    photo = resized(read_style_image(data_dir / "styles" / "great_wave.jpg"), 122, 161)
    back = adain_picture(trunk, decoder, photo, photo)
    assert back.shape == photo.shape and float((back - photo).abs().mean()) < 0.06
    painting = read_style_image(data_dir / "styles" / "starry_night.jpg")[:, :200, :300]
    styled = adain_picture(trunk, decoder, photo, painting)
    apart = [float((p.mean((1, 2)) - painting.mean((1, 2))).abs().mean()) for p in (photo, styled)]
    assert apart[1] < 0.6 * apart[0]


WANTED = picture(6, 8, 2)


def towards(image: torch.Tensor):
    loss = (image - WANTED).square().sum()
    return loss, {"style": float(loss.detach())}


def test_steps_are_those_of_adam():
    made, other = ImageOptimization(picture(6, 8, 1), None, 0.0, 0.01), picture(6, 8, 1).requires_grad_()
    adam = torch.optim.Adam([other], lr=0.01, betas=(0.9, 0.99), eps=1e-8)
    for _ in range(7):
        made.step(towards)
        adam.zero_grad()
        towards(other)[0].backward()
        adam.step()
    assert float((made.colors - other.detach()).abs().max()) < 1e-6


def test_what_is_not_covered_stays_background_and_half_of_it_half():
    alpha = torch.zeros(6, 8)
    alpha[:3], alpha[3] = 1, 0.5
    start = alpha * picture(6, 8, 1) + (1 - alpha) * 0.7
    made = ImageOptimization(start, alpha, 0.7, 0.05)
    assert float((made.seen() - start).abs().max()) < 1e-6
    for _ in range(60):
        made.step(towards)
    assert float((made.seen()[:, 4:] - 0.7).abs().max()) < 1e-6
    assert float((made.seen()[:, :3] - WANTED[:, :3]).abs().max()) < 0.03
    assert float((made.seen()[:, 3] - 0.35).min()) >= -1e-6 and float(made.seen()[:, 3].max()) <= 0.85 + 1e-6
    assert 0 <= float(made.colors.min()) and float(made.colors.max()) <= 1


def test_of_a_part_alone_the_rest_stays_the_picture_that_it_began_as():
    alpha, start = torch.zeros(6, 8), picture(6, 8, 1)
    alpha[:3] = 1
    made = ImageOptimization(start, alpha, start, 0.05)
    for _ in range(60):
        made.step(towards)
    assert torch.equal(made.seen()[:, 3:], start[:, 3:])
    assert float((made.seen()[:, :3] - WANTED[:, :3]).abs().max()) < 0.03


def test_a_picture_that_was_put_aside_goes_on_to_the_same_bits():
    whole, first = (ImageOptimization(picture(6, 8, 1), None, 0.0, 0.02) for _ in range(2))
    for at in range(6):
        whole.step(towards, 1 - at / 6)
    for at in range(4):
        first.step(towards, 1 - at / 6)
    second = ImageOptimization(picture(6, 8, 1), None, 0.0, 0.02)
    second.restore({k: v.copy() for k, v in first.arrays().items()})
    for at in range(4, 6):
        second.step(towards, 1 - at / 6)
    assert np.array_equal(second.pixels(), whole.pixels())
    found, parts = painted(picture(6, 8, 1), None, 0.0, towards, 6, 0.02)
    assert np.array_equal(found, whole.pixels()) and parts["style"] < towards(picture(6, 8, 1))[1]["style"]
