"""Perceptual distances: LPIPS v0.1 (Zhang et al. 2018) and ST-LPIPS (shift-tolerant; Ghildyal and Liu 2022).

    d(x, y) = sum_l mean_hw sum_c w_lc (f_lc(x)/|f_l(x)| - f_lc(y)/|f_l(y)|)^2

with f_l the ReLU outputs of five or seven layers of a network, |.| the norm over channels, and w the trained heads.
Images are sRGB 0..1. Weights are a flat dictionary: convolutions, `input.scale` and `input.shift` (the network's input
is scale * rgb + shift), and `head.l` [c].
"""

from collections.abc import Iterable, Mapping

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from stylerf.errors import InvalidValue
from stylerf.style.feature_extractor import BLUR_KERNEL, FeatureExtractor, blur_pool

NORM_FLOOR = 1e-10  # added to each norm, as in LPIPS
VGG_LAYERS = ("conv1_2", "conv2_2", "conv3_3", "conv4_3", "conv5_3")
HEADS = {"vgg": 5, "vgg-blur": 5, "alex": 5, "alex-blur": 5, "squeeze": 7}


class _Network(nn.Module):
    """Holds pretrained weights as buffers: `<layer>_weight`, `<layer>_bias`, and the input scaling."""

    input_scale: Tensor
    input_shift: Tensor

    def __init__(self, state: Mapping[str, Tensor], layers: Iterable[str]):
        super().__init__()
        for layer in layers:
            for kind in ("weight", "bias"):
                values = state[f"{layer}.{kind}"].float()
                values = values.contiguous(memory_format=torch.channels_last) if values.dim() == 4 else values
                self.register_buffer(f"{layer.replace('.', '_')}_{kind}", values)
        self.register_buffer("input_scale", state["input.scale"].float().reshape(1, 3, 1, 1))
        self.register_buffer("input_shift", state["input.shift"].float().reshape(1, 3, 1, 1))

    def convolve(self, values: Tensor, layer: str, stride: int = 1, padding: int = 0) -> Tensor:
        weight, bias = (self.get_buffer(f"{layer}_{kind}") for kind in ("weight", "bias"))
        return F.conv2d(values, weight, bias, stride=stride, padding=padding)


class AlexFeatures(_Network):
    """Five ReLU outputs of AlexNet; `shift_tolerant`: ST-LPIPS's variant with stride 1 and blurred subsampling."""

    blur: Tensor

    def __init__(self, state: Mapping[str, Tensor], shift_tolerant: bool):
        super().__init__(state, [f"conv{i}" for i in range(1, 6)])
        self.shift_tolerant = shift_tolerant
        blur = torch.tensor(BLUR_KERNEL)
        self.register_buffer("blur", torch.outer(blur, blur) / blur.sum() ** 2)

    def forward(self, image: Tensor) -> list[Tensor]:
        """Return the five feature maps of images [n, 3, h, w]."""
        hidden = image * self.input_scale + self.input_shift
        if self.shift_tolerant:
            # ST-LPIPS blurs the first convolution's output before its ReLU, and later pools after the maximum.
            first = F.relu(blur_pool(self.convolve(hidden, "conv1", padding=2), self.blur))
        else:
            first = F.relu(self.convolve(hidden, "conv1", stride=4, padding=2))
        second = F.relu(self.convolve(self._pool(first), "conv2", padding=2))
        third = F.relu(self.convolve(self._pool(second), "conv3", padding=1))
        fourth = F.relu(self.convolve(third, "conv4", padding=1))
        fifth = F.relu(self.convolve(fourth, "conv5", padding=1))
        return [first, second, third, fourth, fifth]

    def _pool(self, hidden: Tensor) -> Tensor:
        if self.shift_tolerant:
            return blur_pool(F.max_pool2d(hidden, 3, stride=1), self.blur)
        return F.max_pool2d(hidden, 3, stride=2)


class SqueezeFeatures(_Network):
    """The seven outputs of SqueezeNet 1.1 used by LPIPS: the first convolution and groups of fire modules."""

    GROUPS = ((3, 4), (6, 7), (9,), (10,), (11,), (12,))  # fire modules between outputs, with torchvision's numbers
    POOLED = 3  # 3x3 max pooling with stride 2 precedes the first three groups

    def __init__(self, state: Mapping[str, Tensor]):
        fires = [f"fire{number}" for group in self.GROUPS for number in group]
        parts = [f"{fire}.{part}" for fire in fires for part in ("squeeze", "expand1x1", "expand3x3")]
        super().__init__(state, ["conv1", *parts])

    def forward(self, image: Tensor) -> list[Tensor]:
        """Return the seven feature maps of images [n, 3, h, w]."""
        hidden = F.relu(self.convolve(image * self.input_scale + self.input_shift, "conv1", stride=2))
        found = [hidden]
        for place, group in enumerate(self.GROUPS):
            # ceil_mode as in torchvision's SqueezeNet: the trained heads expect it.
            if place < self.POOLED:
                hidden = F.max_pool2d(hidden, 3, stride=2, ceil_mode=True)
            for fire in group:
                hidden = self._fire(hidden, fire)
            found.append(hidden)
        return found

    def _fire(self, hidden: Tensor, fire: int) -> Tensor:
        narrow = F.relu(self.convolve(hidden, f"fire{fire}_squeeze"))
        wide = [self.convolve(narrow, f"fire{fire}_expand{side}x{side}", padding=side // 2) for side in (1, 3)]
        return F.relu(torch.cat(wide, dim=1))


class PerceptualDistance(nn.Module):
    """A perceptual metric: a network of kind "vgg", "vgg-blur", "alex", "alex-blur" or "squeeze", and its heads."""

    def __init__(self, state: Mapping[str, Tensor], kind: str):
        super().__init__()
        if kind not in HEADS:
            raise InvalidValue(f"expected a perceptual network among {', '.join(HEADS)}, found {kind!r}")
        missing = [f"head.{i}" for i in range(HEADS[kind]) if f"head.{i}" not in state]
        if missing:
            raise InvalidValue(f"weights of a perceptual metric need {missing[0]}; these have no such head")
        self.network: nn.Module
        if kind.startswith("vgg"):
            self.network = FeatureExtractor(state, VGG_LAYERS, "vgg16-blur" if kind == "vgg-blur" else "vgg16")
        elif kind == "squeeze":
            self.network = SqueezeFeatures(state)
        else:
            self.network = AlexFeatures(state, shift_tolerant=kind == "alex-blur")
        self.count = HEADS[kind]
        for i in range(self.count):
            self.register_buffer(f"head{i}", state[f"head.{i}"].float())

    def forward(self, first: Tensor, second: Tensor) -> Tensor:
        """Return the distances [n] of image pairs [n, 3, h, w]; 0 for equal images."""
        first_level, *rest = (level.mean(dim=(1, 2)) for level in self.levels(first, second))
        return sum(rest, first_level)

    def maps(self, first: Tensor, second: Tensor) -> Tensor:
        """Return distance maps [n, h, w]: the sum of all levels, bilinearly resized to the images.

        The mean over a mask is the distance for that part of the image, although receptive fields extend beyond it.
        """
        size = first.shape[2:]
        first_level, *rest = (
            F.interpolate(level[:, None], size=size, mode="bilinear", align_corners=False)[:, 0]
            for level in self.levels(first, second)
        )
        return sum(rest, first_level)

    def levels(self, first: Tensor, second: Tensor) -> list[Tensor]:
        """Return weighted squared differences at each position of each level, [n, h_l, w_l]."""
        if first.shape != second.shape or first.dim() != 4 or first.shape[1] != 3:
            raise InvalidValue(
                f"expected two equal batches [n, 3, h, w], found {tuple(first.shape)}, {tuple(second.shape)}"
            )
        # On a CPU, convolutions and pooling take a third less time in channels-last format.
        first, second = (one.contiguous(memory_format=torch.channels_last) for one in (first, second))
        found = []
        for i, (f, g) in enumerate(zip(self.network(first), self.network(second), strict=True)):
            head = getattr(self, f"head{i}").view(1, -1, 1, 1)
            found.append(((_unit(f) - _unit(g)).square() * head).sum(dim=1))
        return found


def _unit(features: Tensor) -> Tensor:
    return features / (torch.linalg.vector_norm(features, dim=1, keepdim=True) + NORM_FLOOR)
