"""Perceptual distances: LPIPS v0.1 (Zhang et al. 2018) and ST-LPIPS (shift-tolerant; Ghildyal and Liu 2022).

    d(x, y) = sum_l mean_hw sum_c w_lc (f_lc(x)/|f_l(x)| - f_lc(y)/|f_l(y)|)^2

with f_l the ReLU outputs of five or seven layers of a network, |.| the length over channels at a position, and w the
trained heads. Images are sRGB in [0, 1]. Weights come as a flat dictionary: convolutions, `input.scale`, `input.shift`
(the network sees scale * rgb + shift) and `head.l` [c].
"""

from collections.abc import Mapping

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from stylerf.errors import InvalidValue
from stylerf.style.feature_extractor import BLUR_TAPS, FeatureExtractor, blur_pool

LENGTH_FLOOR = 1e-10  # added to each length, as in LPIPS
VGG_TAPS = ("conv1_2", "conv2_2", "conv3_3", "conv4_3", "conv5_3")
HEADS = {"vgg": 5, "vgg-blur": 5, "alex": 5, "alex-blur": 5, "squeeze": 7}


class AlexFeatures(nn.Module):
    """Five ReLU outputs of AlexNet; `shift_tolerant`: ST-LPIPS' variant with stride 1 and blurred subsampling."""

    def __init__(self, state: Mapping[str, Tensor], shift_tolerant: bool):
        super().__init__()
        self.shift_tolerant = shift_tolerant
        for i in range(1, 6):
            self.register_buffer(f"weight{i}", state[f"conv{i}.weight"].float())
            self.register_buffer(f"bias{i}", state[f"conv{i}.bias"].float())
        _register_input(self, state)
        blur = torch.tensor(BLUR_TAPS)
        self.register_buffer("blur", torch.outer(blur, blur) / blur.sum() ** 2)

    def forward(self, image: Tensor) -> list[Tensor]:
        """[n, 3, h, w] -> five feature maps."""
        hidden = image * self.input_scale + self.input_shift
        if self.shift_tolerant:
            # The first convolution is blurred before its ReLU, the later pools after their maximum.
            first = F.relu(blur_pool(F.conv2d(hidden, self.weight1, self.bias1, padding=2), self.blur))
        else:
            first = F.relu(F.conv2d(hidden, self.weight1, self.bias1, stride=4, padding=2))
        second = F.relu(F.conv2d(self._pool(first), self.weight2, self.bias2, padding=2))
        third = F.relu(F.conv2d(self._pool(second), self.weight3, self.bias3, padding=1))
        fourth = F.relu(F.conv2d(third, self.weight4, self.bias4, padding=1))
        fifth = F.relu(F.conv2d(fourth, self.weight5, self.bias5, padding=1))
        return [first, second, third, fourth, fifth]

    def _pool(self, hidden: Tensor) -> Tensor:
        if self.shift_tolerant:
            return blur_pool(F.max_pool2d(hidden, 3, stride=1), self.blur)
        return F.max_pool2d(hidden, 3, stride=2)


class SqueezeFeatures(nn.Module):
    """Seven outputs of SqueezeNet 1.1: of the first convolution and of each group of fire modules that LPIPS taps."""

    GROUPS = ((3, 4), (6, 7), (9,), (10,), (11,), (12,))  # fire modules by torchvision's number between taps
    POOLED = 3  # a 3x3 maximum at stride 2 precedes the first three groups

    def __init__(self, state: Mapping[str, Tensor]):
        super().__init__()
        self.register_buffer("weight1", state["conv1.weight"].float())
        self.register_buffer("bias1", state["conv1.bias"].float())
        for fire in (number for group in self.GROUPS for number in group):
            for part in ("squeeze", "expand1x1", "expand3x3"):
                for kind in ("weight", "bias"):
                    self.register_buffer(f"{part}{fire}_{kind}", state[f"fire{fire}.{part}.{kind}"].float())
        _register_input(self, state)

    def forward(self, image: Tensor) -> list[Tensor]:
        """[n, 3, h, w] -> seven feature maps."""
        hidden = F.relu(F.conv2d(image * self.input_scale + self.input_shift, self.weight1, self.bias1, stride=2))
        found = [hidden]
        for place, group in enumerate(self.GROUPS):
            if place < self.POOLED:
                hidden = F.max_pool2d(hidden, 3, stride=2, ceil_mode=True)
            for fire in group:
                hidden = self._fire(hidden, fire)
            found.append(hidden)
        return found

    def _fire(self, hidden: Tensor, fire: int) -> Tensor:
        def convolve(values: Tensor, part: str, padding: int) -> Tensor:
            weight, bias = getattr(self, f"{part}{fire}_weight"), getattr(self, f"{part}{fire}_bias")
            return F.relu(F.conv2d(values, weight, bias, padding=padding))

        narrow = convolve(hidden, "squeeze", 0)
        return torch.cat([convolve(narrow, "expand1x1", 0), convolve(narrow, "expand3x3", 1)], dim=1)


class PerceptualDistance(nn.Module):
    """One metric: a network of kind "vgg", "vgg-blur", "alex", "alex-blur" or "squeeze" and its heads."""

    def __init__(self, state: Mapping[str, Tensor], kind: str):
        super().__init__()
        if kind not in HEADS:
            raise InvalidValue(f"expected a perceptual network among {', '.join(HEADS)}, found {kind!r}")
        missing = [f"head.{i}" for i in range(HEADS[kind]) if f"head.{i}" not in state]
        if missing:
            raise InvalidValue(f"weights of a perceptual metric need {missing[0]}; these have no such head")
        if kind.startswith("vgg"):
            self.network = FeatureExtractor(state, VGG_TAPS, "vgg16-blur" if kind == "vgg-blur" else "vgg16")
        elif kind == "squeeze":
            self.network = SqueezeFeatures(state)
        else:
            self.network = AlexFeatures(state, shift_tolerant=kind == "alex-blur")
        self.count = HEADS[kind]
        for i in range(self.count):
            self.register_buffer(f"head{i}", state[f"head.{i}"].float())

    def forward(self, first: Tensor, second: Tensor) -> Tensor:
        """Distance of image pairs [n, 3, h, w] -> [n], >= 0 and 0 for equal images."""
        return sum(level.mean(dim=(1, 2)) for level in self.levels(first, second))

    def maps(self, first: Tensor, second: Tensor) -> Tensor:
        """The same as a map over pixels, [n, h, w]: each level brought to full size (bilinear) and added.

        Its mean over a mask is the distance of that part of the picture; receptive fields reach beyond it.
        """
        size = first.shape[2:]
        return sum(
            F.interpolate(level[:, None], size=size, mode="bilinear", align_corners=False)[:, 0]
            for level in self.levels(first, second)
        )

    def levels(self, first: Tensor, second: Tensor) -> list[Tensor]:
        """Weighted squared differences per level and position, [n, h_l, w_l] each."""
        if first.shape != second.shape or first.dim() != 4 or first.shape[1] != 3:
            raise InvalidValue(
                f"expected two equal batches [n, 3, h, w], found {tuple(first.shape)}, {tuple(second.shape)}"
            )
        found = []
        for i, (f, g) in enumerate(zip(self.network(first), self.network(second), strict=True)):
            head = getattr(self, f"head{i}").view(1, -1, 1, 1)
            found.append(((_unit(f) - _unit(g)).square() * head).sum(dim=1))
        return found


def _unit(features: Tensor) -> Tensor:
    return features / (torch.linalg.vector_norm(features, dim=1, keepdim=True) + LENGTH_FLOOR)


def _register_input(module: nn.Module, state: Mapping[str, Tensor]) -> None:
    module.register_buffer("input_scale", state["input.scale"].float().reshape(1, 3, 1, 1))
    module.register_buffer("input_shift", state["input.shift"].float().reshape(1, 3, 1, 1))
