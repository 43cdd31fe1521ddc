"""Trunks against a naive loop, by layer names, by what they refuse."""

import numpy as np
import pytest
import torch
from scipy.signal import correlate

from stylerf.errors import InvalidValue
from stylerf.style import feature_extractor
from stylerf.style.feature_extractor import LAYERS, FeatureExtractor, blur_pool, features, layers_of

CHANNELS = {"conv1_1": 4, "conv1_2": 5, "conv2_1": 6, "conv2_2": 6, "conv3_1": 7, "conv3_2": 5, "conv3_3": 8}


def small_state(seed: int = 0) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    state = {"input.scale": torch.tensor([2.0, 3.0, 0.5]), "input.shift": torch.tensor([-0.3, 0.1, 0.7])}
    previous = 3
    for layer, channels in CHANNELS.items():
        state[f"{layer}.weight"] = torch.randn(channels, previous, 3, 3, generator=generator) * 0.4
        state[f"{layer}.bias"] = torch.randn(channels, generator=generator) * 0.2
        previous = channels
    return state


def naive_convolution(image: np.ndarray, weight: np.ndarray, bias: np.ndarray, padding: str) -> np.ndarray:
    """ReLU of a 3x3 convolution [c, h, w] through scipy, channel by channel, in float64."""
    mode = "constant" if padding == "zeros" else "reflect"
    padded = np.pad(image, ((0, 0), (1, 1), (1, 1)), mode=mode)
    found = [sum(correlate(padded[i], kernel[i], mode="valid") for i in range(len(image))) for kernel in weight]
    return np.maximum(np.stack(found) + bias[:, None, None], 0)


def naive_maximum(image: np.ndarray, ceil: bool) -> np.ndarray:
    c, h, w = image.shape
    rows, columns = (-(-h // 2), -(-w // 2)) if ceil else (h // 2, w // 2)
    found = np.zeros((c, rows, columns))
    for i in range(rows):
        for j in range(columns):
            found[:, i, j] = image[:, 2 * i : 2 * i + 2, 2 * j : 2 * j + 2].max(axis=(1, 2))
    return found


def naive_blur(image: np.ndarray) -> np.ndarray:
    """2x2 maximum at stride 1, borders reflected by 2, 1-2-1 filter at every other place."""
    c, h, w = image.shape
    peak = np.zeros((c, h - 1, w - 1))
    for i in range(h - 1):
        for j in range(w - 1):
            peak[:, i, j] = image[:, i : i + 2, j : j + 2].max(axis=(1, 2))
    padded = np.pad(peak, ((0, 0), (2, 2), (2, 2)), mode="reflect")
    kernel = np.outer([1, 2, 1], [1, 2, 1]) / 16
    return np.stack([correlate(channel, kernel, mode="valid")[::2, ::2] for channel in padded])


@pytest.mark.parametrize("architecture", ["vgg16", "vgg16-ceil", "vgg16-blur", "vgg19-reflect"])
def test_every_layer_equals_a_naive_computation(architecture):
    state = small_state()
    image = torch.rand(3, 13, 18, generator=torch.Generator().manual_seed(1))
    hidden = image.double().numpy() * np.array([2.0, 3.0, 0.5])[:, None, None]
    hidden = hidden + np.array([-0.3, 0.1, 0.7])[:, None, None]
    expected = {}
    for layer in CHANNELS:
        if layer in ("conv2_1", "conv3_1"):
            ceil = architecture in ("vgg16-ceil", "vgg19-reflect")
            hidden = naive_blur(hidden) if architecture == "vgg16-blur" else naive_maximum(hidden, ceil)
        padding = "reflect" if architecture == "vgg19-reflect" else "zeros"
        weight, bias = state[f"{layer}.weight"].double().numpy(), state[f"{layer}.bias"].double().numpy()
        hidden = naive_convolution(hidden, weight, bias, padding)
        expected[layer] = hidden
    taps = tuple(CHANNELS)
    for tap, found in zip(taps, FeatureExtractor(state, taps, architecture)(image[None])):
        np.testing.assert_allclose(found[0].numpy(), expected[tap], rtol=1e-4, atol=1e-5)


def test_only_the_layers_up_to_the_deepest_tap_are_built():
    trunk = FeatureExtractor(small_state(), "conv2_1")
    assert trunk.built == ("conv1_1", "conv1_2", "conv2_1") and trunk.channels == (6,) and trunk.stride == 2
    assert not any(name.startswith("conv2_2") for name, _ in trunk.named_buffers())


def test_fewer_layers_of_an_extractor_are_the_same_features():
    trunk = FeatureExtractor(small_state(), "conv1_2,conv2_1,conv3_1")
    image = torch.rand(1, 3, 16, 18, generator=torch.Generator().manual_seed(0))
    less = trunk.only("conv1_2,conv2_1")
    assert less.layers == ("conv1_2", "conv2_1") and less.built == ("conv1_1", "conv1_2", "conv2_1")
    for one, other in zip(less(image), trunk(image)[:2], strict=True):
        assert torch.equal(one, other)
    assert trunk.layers == ("conv1_2", "conv2_1", "conv3_1") and len(trunk(image)) == 3
    for same in ("", "conv4_1", "conv1_2,conv2_1,conv3_1,conv5_1"):
        assert trunk.only(same) is trunk, same


def test_gradient_of_the_image_is_exact_and_weights_have_none():
    trunk = FeatureExtractor(small_state(), "conv1_2,conv3_1").double()
    image = torch.rand(1, 3, 8, 9, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda x: tuple(trunk(x)), (image,))
    assert list(trunk.parameters()) == []


def test_taps_are_named_in_several_ways():
    assert layers_of("conv3") == ("conv3_1", "conv3_2", "conv3_3")
    assert layers_of("conv3_1, conv1_2") == ("conv1_2", "conv3_1")
    assert layers_of(["conv4_1", "conv4_1"]) == ("conv4_1",)
    assert layers_of(LAYERS) == LAYERS
    for wrong in ("conv6", "conv1_3", "", "3_1"):
        with pytest.raises(InvalidValue):
            layers_of(wrong)


def test_bad_arguments_are_refused():
    with pytest.raises(InvalidValue, match="end before conv4_1"):
        FeatureExtractor(small_state(), "conv4_1")
    with pytest.raises(InvalidValue, match="unknown feature extractor"):
        FeatureExtractor(small_state(), "conv1_1", "resnet")
    trunk = FeatureExtractor(small_state(), "conv3_1")
    for shape in ((3, 16, 16), (1, 4, 16, 16), (1, 3, 7, 16)):
        with pytest.raises(InvalidValue):
            trunk(torch.zeros(shape))


def test_blur_keeps_a_constant_and_half_precision_is_ignored_on_the_cpu():
    kernel = torch.outer(torch.tensor([1.0, 2, 1]), torch.tensor([1.0, 2, 1])) / 16
    assert torch.allclose(blur_pool(torch.full((1, 2, 9, 7), 0.3), kernel), torch.tensor(0.3))
    trunk, image = FeatureExtractor(small_state(), "conv1_1"), torch.rand(1, 3, 8, 8)
    assert torch.equal(features(trunk, image, torch.bfloat16)[0], trunk(image)[0])


def test_halving_averages_and_stays_in_range():
    image = torch.rand(3, 64, 96, generator=torch.Generator().manual_seed(0))
    half = feature_extractor.resized(image, 32, 48)
    # the antialiasing triangle at factor 2 weighs 1 3 3 1 along each axis
    padded = torch.tensor([1.0, 3, 3, 1]) / 8
    expected = torch.einsum("i,j,cij->c", padded, padded, image[:, 9:13, 19:23])
    torch.testing.assert_close(half[:, 5, 10], expected)
    assert float(half.min()) >= float(image.min()) and float(half.max()) <= float(image.max())
    assert feature_extractor.resized(image, 64, 96) is image


def test_long_sides_and_scale():
    painting = torch.rand(3, 640, 1024)
    assert feature_extractor.fitted(painting, 252).shape == (3, 158, 252)
    assert feature_extractor.fitted(painting, 800).shape == (3, 500, 800)
    assert feature_extractor.fitted(torch.rand(3, 1, 900), 30).shape == (3, 1, 30)
    assert feature_extractor.feature_size(378, 505, 0.5) == (189, 252)
    with pytest.raises(InvalidValue):
        feature_extractor.resized(painting, 0, 5)
