"""Convolutions by Winograd's transforms, and the extractor that uses them, against direct ones in float64."""

import pytest
import torch
import torch.nn.functional as F

from stylerf.style import feature_extractor
from stylerf.style.cpu_convolution import convolve_relu, frozen, winograd_available
from stylerf.style.feature_extractor import FeatureExtractor

needs_winograd = pytest.mark.skipif(not winograd_available(), reason="this build of torch has no NNPACK")


def direct(image: torch.Tensor, weight: torch.Tensor, bias: torch.Tensor) -> torch.Tensor:
    return F.relu(F.conv2d(image.double(), weight.double(), bias.double(), padding=1))


@needs_winograd
@pytest.mark.parametrize(("channels", "outputs"), [(3, 8), (16, 24), (32, 16)])
@pytest.mark.parametrize("size", [(12, 16), (17, 23)])
def test_convolution_and_its_gradient_are_those_of_a_direct_one(channels, outputs, size):
    generator = torch.Generator().manual_seed(1)
    image = torch.randn(1, channels, *size, generator=generator)
    weight = torch.randn(outputs, channels, 3, 3, generator=generator) / (3 * channels**0.5)
    bias = torch.randn(outputs, generator=generator)
    fast, slow = image.clone().requires_grad_(), image.clone().requires_grad_()
    found, expected = convolve_relu(fast, frozen(weight, bias)), direct(slow, weight, bias)
    assert float((found - expected).detach().abs().max()) < 1e-4
    # Where the sum is all but 0, rounding decides whether the ReLU lets a gradient through.
    gradient = torch.randn(expected.shape, generator=generator) * (expected.abs() > 1e-3)
    found.backward(gradient)
    expected.backward(gradient.double())
    assert float((fast.grad - slow.grad).abs().max()) < 1e-4


@needs_winograd
@pytest.mark.parametrize("architecture", ["vgg16", "vgg16-ceil"])
def test_an_extractor_has_the_same_features_and_gradients_either_way(architecture, monkeypatch):
    generator, state, before = torch.Generator().manual_seed(2), {}, 3
    for layer, channels in {"conv1_1": 16, "conv1_2": 16, "conv2_1": 32, "conv2_2": 32, "conv3_1": 48}.items():
        state[f"{layer}.weight"] = torch.randn(channels, before, 3, 3, generator=generator) * (2 / (9 * before)) ** 0.5
        state[f"{layer}.bias"] = torch.randn(channels, generator=generator) * 0.1
        before = channels
    state |= {"input.scale": torch.tensor([2.0, 3.0, 1.5]), "input.shift": torch.tensor([-0.7, -1.1, -0.6])}
    image = torch.rand(1, 3, 37, 51, generator=generator)

    def gradient_and_features(extractor):
        given = image.clone().requires_grad_()
        found = extractor(given)
        sum(feature.square().mean() for feature in found).backward()
        return given.grad, [feature.detach() for feature in found]

    fast_gradient, fast = gradient_and_features(FeatureExtractor(state, "conv2_1,conv3_1", architecture))
    monkeypatch.setattr(feature_extractor, "winograd_available", lambda: False)
    slow_gradient, slow = gradient_and_features(FeatureExtractor(state, "conv2_1,conv3_1", architecture))
    for one, other in zip(fast, slow, strict=True):
        assert one.shape == other.shape and float((one - other).abs().max()) < 1e-4 * float(other.std())
    assert float((fast_gradient - slow_gradient).norm() / slow_gradient.norm()) < 0.01
