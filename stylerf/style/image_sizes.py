"""Sizes of the painting and of the pictures that features are taken from."""

import torch.nn.functional as F
from torch import Tensor

from stylerf.errors import InvalidValue


def resized(image: Tensor, height: int, width: int) -> Tensor:
    """An image [c, h, w] brought to another size: every result pixel averages what it covers (antialiased bilinear).

    Values stay inside the range of the input. Works on sRGB values, as the networks and the papers do.
    """
    if height < 1 or width < 1:
        raise InvalidValue(f"an image of {width}x{height} pixels has no pixel")
    if image.shape[1:] == (height, width):
        return image
    return F.interpolate(image[None], size=(height, width), mode="bilinear", antialias=True, align_corners=False)[0]


def fitted(image: Tensor, long_side: int) -> Tensor:
    """An image [c, h, w] scaled, proportions kept, so that its longer side has `long_side` pixels (none under 1)."""
    height, width = image.shape[1:]
    factor = long_side / max(height, width)
    return resized(image, max(1, round(height * factor)), max(1, round(width * factor)))


def feature_size(height: int, width: int, scale: float) -> tuple[int, int]:
    """Height and width of the picture that features are taken from; scale 0.5 is ARF's halving."""
    return max(1, round(height * scale)), max(1, round(width * scale))


def style_picture(painting: Tensor, content_height: int, content_width: int, scale: float = 0.5) -> Tensor:
    """The painting [3, h, w] as its features are wanted: long side = the content's long side, then times `scale`.

    `scale` is that of the content's own features, so that a stroke is as large beside the scene as the painting would
    be when laid over the picture (ARF). A larger one gives larger strokes.
    """
    return fitted(painting, max(1, round(max(content_height, content_width) * scale)))
