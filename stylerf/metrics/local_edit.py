"""What a local edit left alone, and what it changed: errors outside, beside and inside a region's mask.

Images are [h, w, 3], sRGB-encoded 0..1; masks [h, w] bool. A value that is not finite is refused.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt
from skimage.color import rgb2lab

from stylerf.errors import InvalidValue
from stylerf.metrics.image_quality import mse


@dataclass(frozen=True, eq=False)
class EditMasks:
    """Parts of one view, bool [h, w]. inside: shows the region. outside: what counts as background.

    ring: the background next to the region, where an edit that bleeds is seen first.
    """

    inside: np.ndarray
    outside: np.ndarray
    ring: np.ndarray


def split_view(inside: np.ndarray, margin: float, ring: float) -> EditMasks:
    """The region's pixels `inside`, and all that are farther from them than `margin` pixels.

    ring: width in pixels of what counts as next to the region, beyond the margin. Distances are those between pixel
    centers (Euclidean).
    """
    if inside.ndim != 2 or inside.dtype != bool or margin < 0 or ring < 0:
        raise InvalidValue(f"a bool mask [h, w] was expected, got {inside.dtype} {inside.shape}, margin {margin:g}")
    if not inside.any():  # the distance transform knows no empty set
        return EditMasks(inside, ~inside, np.zeros_like(inside))
    distances = distance_transform_edt(~inside)
    return EditMasks(inside, distances > margin, (distances > margin) & (distances <= margin + ring))


def background_mse(image: np.ndarray, reference: np.ndarray, mask: np.ndarray) -> float:
    """sum m (image - reference)^2 / (3 sum m) over pixels and RGB with m = 1 - mask (LAENeRF's measure).

    mask: [h, w], 0 (background) .. 1 (region). InvalidValue where it leaves no background.
    """
    weights = 1 - np.asarray(mask, np.float64)
    if weights.size and (weights.min() < 0 or weights.max() > 1):
        raise InvalidValue("a mask of values 0..1 was expected")
    return mse(image, reference, weights)


@dataclass(frozen=True)
class Change:
    """Means over pixels. absolute: of |a - b| over RGB. lab: of the CIE76 color difference (D65), 2.3 just seen."""

    absolute: float
    lab: float


def mean_change(a: np.ndarray, b: np.ndarray, where: np.ndarray) -> Change | None:
    """How far image a is from b over the pixels `where` [h, w]; None where there are none."""
    if a.shape != b.shape or a.shape != (*where.shape, 3):
        raise InvalidValue(f"images of one size were expected, got {a.shape}, {b.shape} and mask {where.shape}")
    if not where.any():
        return None
    here, there = (np.asarray(image[where], np.float64) for image in (a, b))
    if not (np.isfinite(here).all() and np.isfinite(there).all()):
        raise InvalidValue("an image holds values that are not finite")
    lab = np.linalg.norm(rgb2lab(here) - rgb2lab(there), axis=-1)
    return Change(float(np.abs(here - there).mean()), float(lab.mean()))
