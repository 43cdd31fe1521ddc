"""Stylize a single image: feed-forward with AdaIN and a decoder (Huang and Belongie 2017), or by optimizing its pixels
(Gatys et al. 2016)."""

from collections.abc import Callable, Mapping

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from stylerf.style.feature_extractor import FeatureExtractor
from stylerf.style.style_features import style_features

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
    """Match the mean and standard deviation of each channel of content features [1, c, h, w] to the style's (eq. 8)."""
    mean_c, mean_s = content.mean((2, 3), keepdim=True), style.mean((2, 3), keepdim=True)
    spread_c = (content.var((2, 3), keepdim=True, unbiased=False) + VARIANCE_FLOOR).sqrt()
    spread_s = (style.var((2, 3), keepdim=True, unbiased=False) + VARIANCE_FLOOR).sqrt()
    return (content - mean_c) / spread_c * spread_s + mean_s


@torch.no_grad()
def adain_picture(extractor: FeatureExtractor, decoder: Decoder, photo: Tensor, style_image: Tensor) -> Tensor:
    """Return a photo [3, h, w] stylized by a style image [3 or 4, any, any], in 0..1. extractor: conv3_1 only."""
    height, width = photo.shape[1:]
    (style,) = style_features(extractor, style_image).values()
    stylized = decoder(adain(extractor(photo[None])[-1], style[None]))[0]
    return stylized[:, :height, :width].clamp(0, 1).contiguous()


FIRST, SECOND, FLOOR = 0.9, 0.99, 1e-8  # Adam's betas and epsilon

ImageLoss = Callable[[Tensor], tuple[Tensor, dict[str, float]]]  # maps an image [3, h, w] to the loss and its terms


class ImageOptimization:
    """Optimizes straight colors with Adam; the visible image is alpha colors + (1 - alpha) background.

    Adam moves every color by about `rate` per step, even with a tiny gradient; at low alpha, this is hardly visible.

    Args:
        start: [3, h, w] over the background, sRGB 0..1.
        alpha: [h, w], or None for 1 everywhere.
        background: A gray level, or an image [3, h, w].
        rate: Adam's learning rate.
    """

    def __init__(self, start: Tensor, alpha: Tensor | None, background: float | Tensor, rate: float) -> None:
        self.alpha, self.background, self.rate = alpha, background, rate
        straight = start if alpha is None else (start - (1 - alpha) * self.background) / alpha.clamp_min(1e-3)
        self.colors = straight.detach().clamp(0, 1).clone()
        self.first, self.second, self.steps = torch.zeros_like(start), torch.zeros_like(start), 0

    def seen(self, colors: Tensor | None = None) -> Tensor:
        """Return the visible image [3, h, w]."""
        colors = self.colors if colors is None else colors
        return colors if self.alpha is None else self.alpha * colors + (1 - self.alpha) * self.background

    def step(self, loss: ImageLoss, factor: float = 1.0) -> dict[str, float]:
        """Take one step with `factor` times the rate, keeping colors in 0..1; return the loss terms before the step."""
        colors = self.colors.clone().requires_grad_()
        total, parts = loss(self.seen(colors))
        (gradient,) = torch.autograd.grad(total, colors)
        self.steps += 1
        # Manual Adam: its moments are part of checkpoints, on any device.
        self.first.mul_(FIRST).add_(gradient, alpha=1 - FIRST)
        self.second.mul_(SECOND).addcmul_(gradient, gradient, value=1 - SECOND)
        size = (self.second / (1 - SECOND**self.steps)).sqrt_() + FLOOR
        self.colors.addcdiv_(self.first, size, value=-self.rate * factor / (1 - FIRST**self.steps)).clamp_(0, 1)
        return parts

    def pixels(self) -> np.ndarray:
        """Return the visible image as [h, w, 3] float32."""
        return np.ascontiguousarray(self.seen().permute(1, 2, 0).cpu().numpy())

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the state for a checkpoint."""
        moments = {"colors": self.colors, "first": self.first, "second": self.second}
        return {k: v.cpu().numpy().copy() for k, v in moments.items()} | {"steps": np.asarray([self.steps])}

    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        """Restore the state from arrays()."""
        for name in ("colors", "first", "second"):
            getattr(self, name).copy_(torch.from_numpy(arrays[name]))
        self.steps = int(arrays["steps"][0])


def painted(
    start: Tensor,
    alpha: Tensor | None,
    background: float | Tensor,
    loss: ImageLoss,
    steps: int,
    rate: float,
    enough: Callable[[], bool] = lambda: False,
) -> tuple[np.ndarray, dict[str, float]]:
    """Optimize an image with a learning rate that decays linearly to 0.

    Args:
        start, alpha, background, rate: See ImageOptimization.
        loss: Maps an image [3, h, w] to the loss and its terms.
        enough: Called after every step; stops early if it returns True.

    Returns:
        The image [h, w, 3] float32 and the loss terms before the last step.
    """
    made = ImageOptimization(start, alpha, background, rate)
    for at in range(steps):
        parts = made.step(loss, 1 - at / steps)
        if enough():
            break
    return made.pixels(), parts
