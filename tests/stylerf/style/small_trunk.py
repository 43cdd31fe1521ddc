"""A trunk of random weights with few channels."""

import torch

from stylerf.style.feature_extractor import FeatureExtractor

CHANNELS = {"conv1_1": 5, "conv1_2": 6, "conv2_1": 7, "conv2_2": 8}


def small_trunk(taps: str = "conv1_2,conv2", seed: int = 0) -> FeatureExtractor:
    generator = torch.Generator().manual_seed(seed)
    state = {"input.scale": torch.tensor([2.0, 3.0, 1.5]), "input.shift": torch.tensor([-0.7, -1.1, -0.6])}
    before = 3
    for layer, channels in CHANNELS.items():
        state[f"{layer}.weight"] = torch.randn(channels, before, 3, 3, generator=generator) * (2 / (9 * before)) ** 0.5
        state[f"{layer}.bias"] = torch.randn(channels, generator=generator) * 0.1
        before = channels
    return FeatureExtractor(state, taps)


def picture(height: int, width: int, seed: int) -> torch.Tensor:
    return torch.rand(3, height, width, generator=torch.Generator().manual_seed(seed))
