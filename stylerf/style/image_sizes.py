"""Sizes of the style image and of the images that features are extracted from."""

import torch.nn.functional as F
from torch import Tensor

from stylerf.errors import InvalidValue


def resized(image: Tensor, height: int, width: int) -> Tensor:
    """Resize an image [c, h, w] by antialiased bilinear interpolation, on sRGB values, as the papers do."""
    if height < 1 or width < 1:
        raise InvalidValue(f"an image of {width}x{height} pixels is empty")
    if image.shape[1:] == (height, width):
        return image
    return F.interpolate(image[None], size=(height, width), mode="bilinear", antialias=True, align_corners=False)[0]


def fitted(image: Tensor, long_side: int) -> Tensor:
    """Scale an image [c, h, w] so that its longer side has `long_side` pixels, keeping its proportions."""
    height, width = image.shape[1:]
    factor = long_side / max(height, width)
    return resized(image, max(1, round(height * factor)), max(1, round(width * factor)))


def feature_size(height: int, width: int, scale: float) -> tuple[int, int]:
    """Return height and width of the image that features are extracted from; ARF uses a scale of 0.5."""
    return max(1, round(height * scale)), max(1, round(width * scale))


def style_picture(style_image: Tensor, content_height: int, content_width: int, scale: float = 0.5) -> Tensor:
    """Scale a style image [3, h, w] to the content's longer side times `scale` (ARF).

    With the scale of the content's features, strokes have the size they would have if the style image covered the
    view; a larger scale gives larger strokes.
    """
    return fitted(style_image, max(1, round(max(content_height, content_width) * scale)))
