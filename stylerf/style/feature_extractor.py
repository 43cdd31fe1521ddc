"""Feature extractors: VGG-16 and the first blocks of VGG-19, cut after the deepest layer needed, with frozen weights.

An extractor maps sRGB images 0..1 to the ReLU outputs of named layers: conv3_2 is the second convolution of the third
block. Every architecture is a chain of 3x3 convolutions, each followed by a ReLU, with 2x downsampling between blocks.
Sources of weights differ in input scaling, padding and downsampling.

Weights are a flat dictionary: `conv1_1.weight` [out, in, 3, 3] and `conv1_1.bias` [out] float32, input channels in RGB
order, and `input.scale`, `input.shift` [3]: the network's input is scale * rgb + shift.
"""

from collections.abc import Iterable, Mapping
from copy import copy
from dataclasses import dataclass
from typing import Self

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from stylerf.errors import InvalidValue
from stylerf.style.cpu_convolution import FrozenConvolution, convolve_relu, frozen, max_pool_of_relu, winograd_available

BLOCKS = {1: 2, 2: 2, 3: 3, 4: 3, 5: 3}  # convolutions in each block of VGG-16; VGG-19 agrees up to conv3_3
LAYERS = tuple(f"conv{block}_{i}" for block, count in BLOCKS.items() for i in range(1, count + 1))
BLUR_KERNEL = (1.0, 2.0, 1.0)  # binomial filter of shift-tolerant downsampling


@dataclass(frozen=True)
class Architecture:
    """How an extractor differs from others, apart from its weights.

    Attributes:
        padding: "zeros" or "reflect", before each 3x3 convolution.
        pooling: "max" (2x2, stride 2, odd sizes cut), "max-ceil" (odd sizes keep their last row and column), or "blur"
            (2x2 maximum at stride 1, then a 3x3 binomial filter at stride 2 with reflection padding of 2: ST-LPIPS,
            Ghildyal and Liu 2022).
    """

    padding: str = "zeros"
    pooling: str = "max"


ARCHITECTURES = {
    "vgg16": Architecture(),
    "vgg16-ceil": Architecture(pooling="max-ceil"),
    "vgg16-blur": Architecture(pooling="blur"),
    "vgg19-reflect": Architecture(padding="reflect", pooling="max-ceil"),
}


def layers_of(names: str | Iterable[str]) -> tuple[str, ...]:
    """Parse names of layers ("conv3_1,conv3_2") and of blocks ("conv3" for all its layers), or a sequence of them.

    Returns layers in network order, without duplicates. Raises InvalidValue for an unknown name.
    """
    parts = [part.strip() for part in names.split(",")] if isinstance(names, str) else list(names)
    wanted = set()
    for part in parts:
        matches = [layer for layer in LAYERS if part in (layer, layer.split("_")[0])]
        if not matches:
            raise InvalidValue(f"expected layers such as conv3_1 or conv3, found {part!r}; known: {', '.join(LAYERS)}")
        wanted.update(matches)
    return tuple(layer for layer in LAYERS if layer in wanted)


class FeatureExtractor(nn.Module):
    """A frozen chain of convolutions that returns the ReLU outputs of some of its layers, in network order.

    It ends at the deepest of them. Gradients flow only to the image. Single images on the CPU are convolved by Winograd
    transforms (see cpu_convolution.py). Otherwise, weights and activations are channels-last, which oneDNN runs 1.2 to
    1.4 times faster (measured at 252x189 and 504x378, two threads).

    Args:
        state: Weights in this module's format.
        layers: Layers to return; see layers_of().
        architecture: One of ARCHITECTURES.

    Attributes:
        winograd: Whether Winograd transforms may be used.
    """

    input_scale: Tensor
    input_shift: Tensor
    blur: Tensor

    def __init__(self, state: Mapping[str, Tensor], layers: str | Iterable[str], architecture: str = "vgg16") -> None:
        super().__init__()
        if architecture not in ARCHITECTURES:
            raise InvalidValue(f"unknown feature extractor {architecture!r}; known: {', '.join(ARCHITECTURES)}")
        self.layers = layers_of(layers)
        self.architecture = ARCHITECTURES[architecture]
        self.built = LAYERS[: LAYERS.index(self.layers[-1]) + 1]
        missing = [f"{layer}.weight" for layer in self.built if f"{layer}.weight" not in state]
        if missing:
            raise InvalidValue(f"these weights end before {self.layers[-1]}: {missing[0]} is not among them")
        for name, key in (("input_scale", "input.scale"), ("input_shift", "input.shift")):
            self.register_buffer(name, state[key].detach().float().reshape(1, 3, 1, 1).clone())
        for layer in self.built:
            weight = state[f"{layer}.weight"].detach().float().contiguous(memory_format=torch.channels_last)
            self.register_buffer(f"{layer}_weight", weight)
            self.register_buffer(f"{layer}_bias", state[f"{layer}.bias"].detach().float().clone())
        self.winograd = self.architecture.padding == "zeros" and self.architecture.pooling != "blur"
        self._convolutions: dict[str, FrozenConvolution] = {}
        blur = torch.tensor(BLUR_KERNEL)
        self.register_buffer("blur", torch.outer(blur, blur) / blur.sum() ** 2)

    def only(self, layers: str) -> Self:
        """Return an extractor of those of its layers that are named, with the same weights; itself if none is."""
        kept = tuple(layer for layer in self.layers if layers and layer in layers_of(layers))
        if not kept or kept == self.layers:
            return self
        made = copy(self)
        made.layers, made.built = kept, LAYERS[: LAYERS.index(kept[-1]) + 1]
        return made

    @property
    def channels(self) -> tuple[int, ...]:
        """Number of channels of each returned layer."""
        return tuple(self.get_buffer(f"{layer}_weight").shape[0] for layer in self.layers)

    @property
    def stride(self) -> int:
        """Stride of the deepest layer, pixels."""
        return int(2 ** (int(self.layers[-1][4]) - 1))

    @property
    def radius(self) -> int:
        """Radius of the deepest layer's receptive field, pixels (upper bound)."""
        return self.radius_of(self.layers[-1])

    def radius_of(self, layer: str) -> int:
        """Return the radius of a layer's receptive field, pixels (upper bound)."""
        radius, apart = 0, 1  # apart: pixels between positions
        for one in LAYERS[: LAYERS.index(layer) + 1]:
            if one.endswith("_1") and one != "conv1_1":
                radius += 2 * apart if self.architecture.pooling == "blur" else apart
                apart *= 2
            radius += apart
        return radius

    def forward(self, image: Tensor) -> list[Tensor]:
        """Return one feature map [n, c, h', w'] >= 0 per layer, in network order, for sRGB images [n, 3, h, w].

        Images are 0..1 but not clamped. Raises InvalidValue if they are too small for the deepest layer.
        """
        if image.dim() != 4 or image.shape[1] != 3:
            raise InvalidValue(f"expected images [n, 3, height, width], found {tuple(image.shape)}")
        if min(image.shape[2:]) < 2 * self.stride:
            raise InvalidValue(
                f"{self.layers[-1]} needs images of at least {2 * self.stride} pixels per side, "
                f"found {image.shape[3]}x{image.shape[2]}"
            )
        hidden = image * self.input_scale + self.input_shift
        if self._by_winograd(image):
            return self._forward_by_winograd(hidden)
        hidden = hidden.contiguous(memory_format=torch.channels_last)
        found = []
        for layer in self.built:
            # Pooling belongs to the next block: a layer's output comes before it.
            if layer.endswith("_1") and layer != "conv1_1":
                hidden = self._pool(hidden)
            hidden = self._convolve(hidden, layer)
            if layer in self.layers:
                found.append(hidden)
        return found

    def _by_winograd(self, image: Tensor) -> bool:
        on_cpu = len(image) == 1 and image.device.type == "cpu" and image.dtype == torch.float32
        return self.winograd and on_cpu and winograd_available()

    def _forward_by_winograd(self, hidden: Tensor) -> list[Tensor]:
        found = []
        for layer in self.built:
            if layer.endswith("_1") and layer != "conv1_1":
                hidden = max_pool_of_relu(hidden, ceil=self.architecture.pooling == "max-ceil")
            hidden = convolve_relu(hidden, self._frozen(layer))
            if layer in self.layers:
                found.append(hidden)
        return found

    def _frozen(self, layer: str) -> FrozenConvolution:
        if layer not in self._convolutions:
            self._convolutions[layer] = frozen(self.get_buffer(f"{layer}_weight"), self.get_buffer(f"{layer}_bias"))
        return self._convolutions[layer]

    def _convolve(self, hidden: Tensor, layer: str) -> Tensor:
        weight, bias = self.get_buffer(f"{layer}_weight"), self.get_buffer(f"{layer}_bias")
        if self.architecture.padding == "reflect":
            hidden = F.conv2d(F.pad(hidden, (1, 1, 1, 1), mode="reflect"), weight, bias)
        else:
            hidden = F.conv2d(hidden, weight, bias, padding=1)
        # In place, since autograd needs only the ReLU's result; keeping its input would double the memory.
        return F.relu(hidden, inplace=True)

    def _pool(self, hidden: Tensor) -> Tensor:
        if self.architecture.pooling == "blur":
            return blur_pool(F.max_pool2d(hidden, 2, stride=1), self.blur)
        return F.max_pool2d(hidden, 2, ceil_mode=self.architecture.pooling == "max-ceil")


def blur_pool(hidden: Tensor, kernel: Tensor) -> Tensor:
    """Filter each channel of [n, c, h, w] by `kernel` [k, k] with stride 2 and a reflection padding of 2."""
    channels = hidden.shape[1]
    weight = kernel.to(hidden.dtype).expand(channels, 1, *kernel.shape)
    padded = F.pad(hidden, (2, 2, 2, 2), mode="reflect")
    return F.conv2d(padded, weight, stride=2, groups=channels)


def features(extractor: FeatureExtractor, image: Tensor, half_precision: torch.dtype | None = None) -> list[Tensor]:
    """Return `extractor(image)` as float32, computed on CUDA under autocast to `half_precision` if given.

    Ignored on the CPU, where half precision is mostly emulated and slower.
    """
    if half_precision is None or image.device.type != "cuda":
        return list(extractor(image))
    with torch.autocast("cuda", dtype=half_precision):
        return [feature.float() for feature in extractor(image)]


def by_block(layers: tuple[str, ...], features: list[Tensor]) -> dict[str, Tensor]:
    """Concatenate features [1, c, h, w] of each block's layers along channels (ARF): {"conv3": [sum c, h, w], ...}."""
    blocks: dict[str, list[Tensor]] = {}
    for layer, feature in zip(layers, features, strict=True):
        blocks.setdefault(layer.split("_")[0], []).append(feature[0])
    return {block: parts[0] if len(parts) == 1 else torch.cat(parts) for block, parts in blocks.items()}


def resized(image: Tensor, height: int, width: int) -> Tensor:
    """Resize an image [c, h, w] by antialiased bilinear interpolation of sRGB values, as the papers do."""
    if height < 1 or width < 1:
        raise InvalidValue(f"an image of {width}x{height} pixels is empty")
    if image.shape[1:] == (height, width):
        return image
    return F.interpolate(image[None], size=(height, width), mode="bilinear", antialias=True, align_corners=False)[0]


def fitted(image: Tensor, long_side: int) -> Tensor:
    """Scale an image [c, h, w] so that its longer side has `long_side` pixels, preserving the aspect ratio."""
    height, width = image.shape[1:]
    factor = long_side / max(height, width)
    return resized(image, max(1, round(height * factor)), max(1, round(width * factor)))


def feature_size(height: int, width: int, scale: float) -> tuple[int, int]:
    """Return height and width of the image that features are extracted from; ARF uses a scale of 0.5."""
    return max(1, round(height * scale)), max(1, round(width * scale))
