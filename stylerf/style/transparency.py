"""Style images with transparent parts, which show no style: they are not matched, and their colors do not count.

A style image is [3, h, w], or [4, h, w] with an alpha of 0 or 1.
"""

import numpy as np
import torch
import torch.nn.functional as F
from scipy.ndimage import distance_transform_edt
from torch import Tensor

from stylerf.errors import InvalidValue

SHOWN = 0.5  # alpha from which a pixel is shown, and share of what a feature sees that must be


def without_hidden_colors(pixels: np.ndarray) -> np.ndarray:
    """Cut an image down to what it shows, and replace colors that it does not show.

    Edges of a cutout would be strokes of their own: hidden pixels take the color of the nearest shown one.

    Args:
        pixels: [h, w, 4] float32, straight alpha.

    Returns:
        The smallest rectangle that holds all shown pixels: [h', w', 3] if it has no other, else [h', w', 4] with an
        alpha of 0 or 1. Does not depend on hidden colors.

    Raises:
        InvalidValue: No pixel is shown.
    """
    shown = pixels[..., 3] >= SHOWN
    if not shown.any():
        raise InvalidValue("it is transparent everywhere; give a style image with opaque parts")
    rows, columns = (np.flatnonzero(shown.any(axis)) for axis in (1, 0))
    part = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    colors, shown = pixels[part][..., :3], shown[part]
    if shown.all():
        return np.ascontiguousarray(colors)
    nearest = distance_transform_edt(~shown, return_distances=False, return_indices=True)
    return np.concatenate([colors[tuple(nearest)], shown[..., None]], axis=2).astype(np.float32)


def shown_colors(style_image: Tensor) -> Tensor:
    """Return the colors of a style image [3 or 4, h, w] that count: the image itself, or [3, 1, n] of shown pixels."""
    if style_image.shape[0] == 3:
        return style_image
    return style_image[:3, style_image[3] >= SHOWN][:, None]


def shown_positions(alpha: Tensor, size: tuple[int, int], radius: int) -> Tensor:
    """Return which feature positions show the style: [h', w'] bool.

    Both the pixels of a position and the square of 2 radius + 1 pixels that its feature sees must be shown by half.

    Args:
        alpha: [h, w] of the image that features are extracted from.
        size: (h', w').
        radius: Of what a feature sees, pixels.
    """
    seen = F.avg_pool2d(alpha[None, None], 2 * radius + 1, 1, radius, count_include_pad=False)
    parts = F.interpolate(torch.cat([alpha[None, None], seen], dim=1), size=size, mode="area")[0]
    return (parts >= SHOWN).all(dim=0)
