"""One picture stylized at once: its features take a painting's statistics and are decoded (AdaIN, Huang 2017)."""

from collections.abc import Mapping

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from stylerf.style.feature_extractor import FeatureExtractor

CONVOLUTIONS = 5
DOUBLED_AFTER = (0, 2)  # convolutions whose result is doubled in size: two halvings lie before conv3_1
SPREAD_FLOOR = 1e-5  # added to a channel's variance (AdaIN)


class Decoder(nn.Module):
    """From conv3_1 features of the AdaIN-normalized VGG-19 [n, 256, h, w] to sRGB pictures [n, 3, 4h, 4w]."""

    def __init__(self, state: Mapping[str, Tensor]) -> None:
        super().__init__()
        for i in range(CONVOLUTIONS):
            self.register_buffer(f"weight{i}", state[f"decode{i}.weight"].detach().float())
            self.register_buffer(f"bias{i}", state[f"decode{i}.bias"].detach().float())

    def forward(self, features: Tensor) -> Tensor:
        """Every convolution is 3x3 on a reflected border; all but the last are followed by a ReLU."""
        hidden = features
        for i in range(CONVOLUTIONS):
            padded = F.pad(hidden, (1, 1, 1, 1), mode="reflect")
            hidden = F.conv2d(padded, getattr(self, f"weight{i}"), getattr(self, f"bias{i}"))
            if i < CONVOLUTIONS - 1:
                hidden = F.relu(hidden)
            if i in DOUBLED_AFTER:
                hidden = F.interpolate(hidden, scale_factor=2, mode="nearest")
        return hidden


def adain(content: Tensor, style: Tensor) -> Tensor:
    """Content features [1, c, h, w] with each channel's mean and deviation over positions made the style's (eq. 8)."""
    mean_c, mean_s = content.mean((2, 3), keepdim=True), style.mean((2, 3), keepdim=True)
    spread_c = (content.var((2, 3), keepdim=True, unbiased=False) + SPREAD_FLOOR).sqrt()
    spread_s = (style.var((2, 3), keepdim=True, unbiased=False) + SPREAD_FLOOR).sqrt()
    return (content - mean_c) / spread_c * spread_s + mean_s


@torch.no_grad()
def adain_picture(trunk: FeatureExtractor, decoder: Decoder, photo: Tensor, painting: Tensor) -> Tensor:
    """A photo [3, h, w] in the manner of a painting [3, any, any], [3, h, w] in 0..1. trunk: up to conv3_1 alone."""
    height, width = photo.shape[1:]
    made = decoder(adain(trunk(photo[None])[-1], trunk(painting[None])[-1]))[0]
    return made[:, :height, :width].clamp(0, 1).contiguous()
