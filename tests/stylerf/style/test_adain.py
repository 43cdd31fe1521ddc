"""Feed-forward references: statistics of features, the decoder as a chain, and the real weights where they are."""

import numpy as np
import pytest
import torch
from torch import nn

from stages.weights.sources import wct_decoder
from stylerf.style.adain import Decoder, adain, adain_picture
from stylerf.style.feature_extractor import FeatureExtractor
from stylerf.style.image_sizes import resized


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
    from stages.artifacts.style_images import read_painting
    from stages.weights.resolve import resolve, resolve_decoder

    monkeypatch.setenv("STYLERF_WEIGHTS", str(data_dir / "weights"))
    monkeypatch.setenv("STYLERF_CACHE", str(tmp_path))
    found, decoder = resolve("vgg19-wct"), Decoder(resolve_decoder().state)
    trunk = FeatureExtractor(found.state, "conv3_1", found.kind)
    photo = resized(read_painting(data_dir / "styles" / "great_wave.jpg"), 122, 161)
    back = adain_picture(trunk, decoder, photo, photo)
    assert back.shape == photo.shape and float((back - photo).abs().mean()) < 0.06
    painting = read_painting(data_dir / "styles" / "starry_night.jpg")[:, :200, :300]
    styled = adain_picture(trunk, decoder, photo, painting)
    apart = [float((p.mean((1, 2)) - painting.mean((1, 2))).abs().mean()) for p in (photo, styled)]
    assert apart[1] < 0.6 * apart[0]
