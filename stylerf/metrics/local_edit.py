"""Changes made by a local edit inside, next to and away from its region.

Images are [h, w, 3], sRGB 0..1; masks [h, w] bool. NaN and infinity raise InvalidValue.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt
from skimage.color import rgb2lab

from stylerf.errors import InvalidValue
from stylerf.metrics.image_quality import mse


@dataclass(frozen=True, eq=False)
class EditMasks:
    """Parts of one view, [h, w] bool each.

    Attributes:
        inside: The region.
        outside: The background.
        ring: The background next to the region, where bleeding shows first.
    """

    inside: np.ndarray
    outside: np.ndarray
    ring: np.ndarray


def split_view(inside: np.ndarray, margin: float, ring: float) -> EditMasks:
    """Split a view by the Euclidean distance of pixel centers from the region.

    Args:
        inside: [h, w] bool, the region.
        margin: Pixels within this distance of the region are neither inside nor background.
        ring: Width of the ring beyond the margin, pixels.
    """
    if inside.ndim != 2 or inside.dtype != bool or margin < 0 or ring < 0:
        raise InvalidValue(f"expected a bool mask [h, w], got {inside.dtype} {inside.shape}, margin {margin:g}")
    if not inside.any():  # the distance transform needs at least one pixel
        return EditMasks(inside, ~inside, np.zeros_like(inside))
    distances = distance_transform_edt(~inside)  # pixels, from each background pixel to the region
    return EditMasks(inside, distances > margin, (distances > margin) & (distances <= margin + ring))


def background_mse(image: np.ndarray, reference: np.ndarray, mask: np.ndarray) -> float:
    """Return sum m (image - reference)^2 / (3 sum m) over pixels and RGB with m = 1 - mask (LAENeRF's metric).

    mask: [h, w], 0 (background) .. 1 (region). InvalidValue if it leaves no background.
    """
    weights = 1 - np.asarray(mask, np.float64)
    if weights.size and (weights.min() < 0 or weights.max() > 1):
        raise InvalidValue("expected a mask of values 0..1")
    return mse(image, reference, weights)


@dataclass(frozen=True)
class Change:
    """Means over pixels.

    Attributes:
        absolute: |a - b|, averaged over RGB.
        lab: CIE76 color difference (D65); 2.3 is just noticeable.
    """

    absolute: float
    lab: float


def mean_change(a: np.ndarray, b: np.ndarray, where: np.ndarray) -> Change | None:
    """Return the mean difference of images a and b over the pixels `where` [h, w]; None if there are none."""
    if a.shape != b.shape or a.shape != (*where.shape, 3):
        raise InvalidValue(f"expected images of one size, got {a.shape}, {b.shape} and mask {where.shape}")
    if not where.any():
        return None
    here, there = (np.asarray(image[where], np.float64) for image in (a, b))
    if not (np.isfinite(here).all() and np.isfinite(there).all()):
        raise InvalidValue("an image holds values that are not finite")
    lab = np.linalg.norm(rgb2lab(here) - rgb2lab(there), axis=-1)
    return Change(float(np.abs(here - there).mean()), float(lab.mean()))
