"""Style images with transparent parts, which are not matched and whose colors do not count.

A style image is [3, h, w], or [4, h, w] with an alpha of 0 or 1.
"""

import numpy as np
import torch
import torch.nn.functional as F
from scipy.ndimage import distance_transform_edt
from torch import Tensor

from stylerf.errors import InvalidValue

SHOWN = 0.5  # minimum alpha of a visible pixel, and minimum fraction of a receptive field that must be visible


def without_hidden_colors(pixels: np.ndarray) -> np.ndarray:
    """Crop an image to its visible pixels, and replace hidden colors.

    The edges of a cutout would otherwise act as strokes, so hidden pixels get the color of the nearest visible one.

    Args:
        pixels: [h, w, 4] float32, straight alpha.

    Returns:
        The bounding box of all visible pixels: [h', w', 3] if it has no hidden ones, else [h', w', 4] with an alpha of
        0 or 1. Does not depend on hidden colors.

    Raises:
        InvalidValue: No pixel is visible.
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
    """Return the visible colors of a style image [3 or 4, h, w]: the image itself, or [3, 1, n] of visible pixels."""
    if style_image.shape[0] == 3:
        return style_image
    return style_image[:3, style_image[3] >= SHOWN][:, None]


def shown_positions(alpha: Tensor, size: tuple[int, int], radius: int) -> Tensor:
    """Return which feature positions show the style: [h', w'] bool.

    At least half of a position's own pixels, and of its receptive field of 2 radius + 1 pixels squared, must be
    visible.

    Args:
        alpha: [h, w] of the image that features are extracted from.
        size: (h', w').
        radius: Of the receptive field, pixels.
    """
    seen = F.avg_pool2d(alpha[None, None], 2 * radius + 1, 1, radius, count_include_pad=False)
    parts = F.interpolate(torch.cat([alpha[None, None], seen], dim=1), size=size, mode="area")[0]
    return (parts >= SHOWN).all(dim=0)
