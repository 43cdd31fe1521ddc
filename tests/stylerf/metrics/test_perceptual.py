"""Perceptual distances against a slow computation by scipy, and what any distance must satisfy."""

import numpy as np
import pytest
import torch
from scipy.signal import correlate

from stylerf.errors import InvalidValue
from stylerf.metrics.perceptual import HEADS, PerceptualDistance
from stylerf.style.feature_extractor import LAYERS

ALEX = {"conv1": (4, 3, 11), "conv2": (5, 4, 5), "conv3": (6, 5, 3), "conv4": (5, 6, 3), "conv5": (4, 5, 3)}
FIRES = (3, 4, 6, 7, 9, 10, 11, 12)


def small_state(kind: str) -> dict[str, torch.Tensor]:
    """A network of the right shape with few channels and seeded weights."""
    generator = torch.Generator().manual_seed(7)

    def layer(name: str, shape: tuple[int, ...]) -> dict[str, torch.Tensor]:
        size = float(np.prod(shape[1:])) ** -0.5
        return {
            f"{name}.weight": torch.randn(shape, generator=generator) * 1.5 * size,
            f"{name}.bias": torch.randn(shape[0], generator=generator) * 0.1,
        }

    state = {"input.scale": torch.tensor([4.0, 4.5, 4.4]), "input.shift": torch.tensor([-2.0, -2.1, -1.8])}
    heads = []
    if kind.startswith("vgg"):
        for i, name in enumerate(LAYERS):
            state |= layer(name, (4, 4 if i else 3, 3, 3))
        heads = [4] * 5
    elif kind.startswith("alex"):
        for name, (out, into, size) in ALEX.items():
            state |= layer(name, (out, into, size, size))
        heads = [4, 5, 6, 5, 4]
    else:
        state |= layer("conv1", (4, 3, 3, 3))
        for place, fire in enumerate(FIRES):
            state |= layer(f"fire{fire}.squeeze", (2, 6 if place else 4, 1, 1))
            state |= layer(f"fire{fire}.expand1x1", (3, 2, 1, 1)) | layer(f"fire{fire}.expand3x3", (3, 2, 3, 3))
        heads = [4, 6, 6, 6, 6, 6, 6]
    for i, channels in enumerate(heads):
        state[f"head.{i}"] = torch.rand(channels, generator=generator)
    return state


def pictures(seed: int, height: int = 49, width: int = 58) -> torch.Tensor:
    return torch.rand(2, 3, height, width, generator=torch.Generator().manual_seed(seed))


def convolution(image, weight, bias, stride=1, padding=0):
    padded = np.pad(image, ((0, 0), (padding,) * 2, (padding,) * 2))
    found = [sum(correlate(padded[i], kernel[i], mode="valid") for i in range(len(image))) for kernel in weight]
    return (np.stack(found) + bias[:, None, None])[:, ::stride, ::stride]


def maximum(image, size, stride, ceil=False):
    _, h, w = image.shape
    count = [(-(-(n - size) // stride) if ceil else (n - size) // stride) + 1 for n in (h, w)]
    found = np.zeros((image.shape[0], *count))
    for i in range(count[0]):
        for j in range(count[1]):
            found[:, i, j] = image[:, i * stride : i * stride + size, j * stride : j * stride + size].max(axis=(1, 2))
    return found


def blurred(image):
    padded = np.pad(image, ((0, 0), (2, 2), (2, 2)), mode="reflect")
    kernel = np.outer([1, 2, 1], [1, 2, 1]) / 16
    return np.stack([correlate(channel, kernel, mode="valid")[::2, ::2] for channel in padded])


def slow_features(kind: str, state: dict[str, np.ndarray], image: np.ndarray) -> list[np.ndarray]:
    """The five or seven layers as the papers' networks are drawn, in float64."""
    hidden = image * state["input.scale"][:, None, None] + state["input.shift"][:, None, None]

    def layer(values, name, **options):
        return convolution(values, state[f"{name}.weight"], state[f"{name}.bias"], **options)

    def relu(values):
        return np.maximum(values, 0)

    if kind == "squeeze":
        found = [relu(layer(hidden, "conv1", stride=2))]
        for place, group in enumerate(((3, 4), (6, 7), (9,), (10,), (11,), (12,))):
            values = maximum(found[-1], 3, 2, ceil=True) if place < 3 else found[-1]
            for fire in group:
                narrow = relu(layer(values, f"fire{fire}.squeeze"))
                wide = [layer(narrow, f"fire{fire}.expand1x1"), layer(narrow, f"fire{fire}.expand3x3", padding=1)]
                values = relu(np.concatenate(wide))
            found.append(values)
        return found
    if kind == "alex":
        first = relu(layer(hidden, "conv1", stride=4, padding=2))
        pool = lambda values: maximum(values, 3, 2)  # noqa: E731
    else:
        first = relu(blurred(layer(hidden, "conv1", padding=2)))
        pool = lambda values: blurred(maximum(values, 3, 1))  # noqa: E731
    second = relu(layer(pool(first), "conv2", padding=2))
    third = relu(layer(pool(second), "conv3", padding=1))
    fourth = relu(layer(third, "conv4", padding=1))
    return [first, second, third, fourth, relu(layer(fourth, "conv5", padding=1))]


@pytest.mark.parametrize("kind", ["squeeze", "alex", "alex-blur"])
def test_distance_equals_a_slow_computation(kind):
    state = small_state(kind)
    plain = {name: value.double().numpy() for name, value in state.items()}
    first, second = pictures(0), pictures(1)
    found = PerceptualDistance(state, kind)(first, second)
    for n in range(2):
        a, b = (slow_features(kind, plain, picture[n].double().numpy()) for picture in (first, second))
        total = 0.0
        for i, (f, g) in enumerate(zip(a, b, strict=True)):
            f, g = (v / (np.sqrt((v**2).sum(axis=0)) + 1e-10) for v in (f, g))
            total += (((f - g) ** 2) * plain[f"head.{i}"][:, None, None]).sum(axis=0).mean()
        assert float(found[n]) == pytest.approx(total, rel=1e-4)


@pytest.mark.parametrize("kind", list(HEADS))
def test_distance_is_zero_for_equals_symmetric_and_grows_with_noise(kind):
    metric = PerceptualDistance(small_state(kind), kind)
    picture = pictures(2)
    noise = torch.randn(picture.shape, generator=torch.Generator().manual_seed(3))
    assert metric(picture, picture).abs().max() == 0
    little, much = metric(picture, picture + 0.02 * noise), metric(picture, picture + 0.3 * noise)
    assert (little > 0).all() and (much > little).all()
    torch.testing.assert_close(metric(picture, picture + 0.3 * noise), metric(picture + 0.3 * noise, picture))


@pytest.mark.parametrize("kind", list(HEADS))
def test_maps_match_the_image_size_and_locate_the_difference(kind):
    metric = PerceptualDistance(small_state(kind), kind)
    picture = pictures(4, 80, 128)
    altered = picture.clone()
    altered[:, :, 20:60, 8:24] = 0.5
    found = metric.maps(picture, altered)
    assert found.shape == (2, 80, 128)
    assert (found[:, :, :32].mean(dim=(1, 2)) > 3 * found[:, :, 96:].mean(dim=(1, 2))).all()


def test_black_images_have_finite_gradients_and_bad_input_is_refused():
    metric = PerceptualDistance(small_state("alex"), "alex")
    black = torch.zeros(1, 3, 49, 58, requires_grad=True)
    (gradient,) = torch.autograd.grad(metric(black, pictures(5)[:1]).sum(), black)
    assert torch.isfinite(gradient).all()
    with pytest.raises(InvalidValue):
        metric(pictures(0), pictures(1)[:1])
    with pytest.raises(InvalidValue):
        PerceptualDistance(small_state("alex"), "resnet")
    with pytest.raises(InvalidValue, match="head"):
        PerceptualDistance({k: v for k, v in small_state("alex").items() if k != "head.4"}, "alex")
