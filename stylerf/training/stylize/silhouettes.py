"""Replace the background that the style loss sees beyond an object's silhouette with the mirrored object.

Features at a silhouette see both sides of it. On a white background, they match pale strokes, which would appear as a
rim around the object (decision 0054).
"""

import numpy as np
import torch
from scipy.ndimage import distance_transform_edt
from torch import Tensor

from stylerf.style.transparency import SHOWN


def mirror_pixels(alpha: np.ndarray) -> np.ndarray:
    """Return, for each pixel of a view, the flat index of the pixel that replaces it, [h, w] int32.

    A pixel outside the object is replaced by its mirror image, equally far inside, or by the nearest inside pixel if
    that one is outside too. Pixels of the object, and all pixels of a view without an object, stay themselves.

    Args:
        alpha: Coverage [h, w]; an alpha of SHOWN or more is inside.
    """
    height, width = alpha.shape
    inside = alpha >= SHOWN
    rows, columns = np.indices(alpha.shape)
    if not inside.any():
        return (rows * width + columns).astype(np.int32)
    nearest = distance_transform_edt(~inside, return_distances=False, return_indices=True)
    row, column = 2 * nearest[0] - rows, 2 * nearest[1] - columns
    in_view = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    mirrored = np.where(in_view, row * width + column, 0)
    found = in_view & inside.ravel()[mirrored]
    return np.where(found, mirrored, nearest[0] * width + nearest[1]).astype(np.int32)


@torch.no_grad()
def object_colors(image: Tensor, alpha: Tensor, mirror: Tensor, background: float) -> Tensor:
    """Return an object's colors without the background, mirrored beyond its silhouette, [3, h, w] in 0..1.

    Args:
        image: [3, h, w] over the background.
        alpha: Coverage [h, w].
        mirror: From mirror_pixels(), [h, w].
        background: Gray level, 0..1.
    """
    chosen = mirror.flatten()
    colors = image.flatten(1)[:, chosen].reshape(image.shape)
    covered = alpha.flatten()[chosen].reshape(alpha.shape).clamp_min(SHOWN)
    return ((colors - (1 - covered) * background) / covered).clamp(0, 1)


def over(image: Tensor, alpha: Tensor, background: float, behind: Tensor) -> Tensor:
    """Return an image [3, h, w] over `behind`, [3, h, w] or [3, 1, 1], instead of the background."""
    return image + (1 - alpha) * (behind - background)
