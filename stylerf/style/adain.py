"""Feed-forward stylization of one image: AdaIN of its features, then a decoder (Huang and Belongie 2017)."""

from collections.abc import Mapping

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from stylerf.style.feature_extractor import FeatureExtractor

CONVOLUTIONS = 5
UPSAMPLED_AFTER = (0, 2)  # convolutions followed by 2x upsampling: conv3_1 is at a quarter of the resolution
VARIANCE_FLOOR = 1e-5  # added to a channel's variance (AdaIN)


class Decoder(nn.Module):
    """Decodes conv3_1 features of the AdaIN-normalized VGG-19 [n, 256, h, w] to sRGB images [n, 3, 4h, 4w]."""

    def __init__(self, state: Mapping[str, Tensor]) -> None:
        super().__init__()
        for i in range(CONVOLUTIONS):
            self.register_buffer(f"weight{i}", state[f"decode{i}.weight"].detach().float())
            self.register_buffer(f"bias{i}", state[f"decode{i}.bias"].detach().float())

    def forward(self, features: Tensor) -> Tensor:
        """Apply 3x3 convolutions with reflection padding, all but the last followed by a ReLU."""
        hidden = features
        for i in range(CONVOLUTIONS):
            padded = F.pad(hidden, (1, 1, 1, 1), mode="reflect")
            hidden = F.conv2d(padded, self.get_buffer(f"weight{i}"), self.get_buffer(f"bias{i}"))
            if i < CONVOLUTIONS - 1:
                hidden = F.relu(hidden)
            if i in UPSAMPLED_AFTER:
                hidden = F.interpolate(hidden, scale_factor=2, mode="nearest")
        return hidden


def adain(content: Tensor, style: Tensor) -> Tensor:
    """Match each channel's mean and standard deviation of content features [1, c, h, w] to the style's (eq. 8)."""
    mean_c, mean_s = content.mean((2, 3), keepdim=True), style.mean((2, 3), keepdim=True)
    spread_c = (content.var((2, 3), keepdim=True, unbiased=False) + VARIANCE_FLOOR).sqrt()
    spread_s = (style.var((2, 3), keepdim=True, unbiased=False) + VARIANCE_FLOOR).sqrt()
    return (content - mean_c) / spread_c * spread_s + mean_s


@torch.no_grad()
def adain_picture(extractor: FeatureExtractor, decoder: Decoder, photo: Tensor, style_image: Tensor) -> Tensor:
    """Stylize a photo [3, h, w] by a style image [3, any, any]; [3, h, w] in 0..1. extractor: ends at conv3_1."""
    height, width = photo.shape[1:]
    stylized = decoder(adain(extractor(photo[None])[-1], extractor(style_image[None])[-1]))[0]
    return stylized[:, :height, :width].clamp(0, 1).contiguous()
