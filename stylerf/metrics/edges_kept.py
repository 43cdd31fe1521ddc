"""How much of a photo's structure a stylized view keeps: the fraction of the photo's edges that it contains.

Edges are Canny edges (1986) of the luma in units of its standard deviation, so changes of contrast cost nothing. An
edge of the photo is kept if the stylized view has one within TOLERANCE and with nearly the same orientation (either
sign: inverted contrast keeps an edge). Strokes everywhere would match many edges by chance, so as in Cohen's kappa
(1960), chance agreement is subtracted:

    kept = (r - c) / (1 - c),   r = mean over the photo's edge pixels of M(position, orientation),
                                c = the same for each orientation, but averaged over all positions of the image

M is 1 where an edge of the stylized view is near enough.
"""

import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter
from skimage.feature import canny

from stylerf.errors import InvalidValue
from stylerf.metrics.image_quality import luminance

SIGMA = 0.004  # of the blur before edge detection, relative to the longer side: 2 pixels of 504
TOLERANCE = 0.006  # relative to the longer side: 3 pixels of 504
LOW, HIGH = 0.8, 1.6  # Canny thresholds for the Sobel gradient (8 times the slope per pixel), standard deviations
SIDE = 504  # pixels of the longer side that the thresholds hold for; of a larger image, slopes per pixel are smaller
LEAST_SPREAD = 0.04  # minimum standard deviation of luma, so that flat images are not amplified to have edges
BINS = 8  # of orientation, over 180 degrees; an edge matches its own bin and the two adjacent ones


def edges_kept(stylized: np.ndarray, photo: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Return the fraction of the photo's edges kept by the stylized view, beyond chance: 1: all, 0: as by chance.

    Not differentiable, and not used as a loss; `stylize --structure-weight` has the same aim, using the luma gradient
    in cells of 4 pixels.

    Args:
        stylized, photo: [h, w, 3], sRGB 0..1.
        mask: Pixels that count, [h, w] bool; edges along its border are ignored. None for all.

    Raises:
        InvalidValue: The images differ in size, a value is not finite, or the photo has no edges.
    """
    if stylized.shape != photo.shape or photo.ndim != 3 or photo.shape[2] != 3:
        raise InvalidValue(f"expected two images [h, w, 3] of one size, got {stylized.shape} and {photo.shape}")
    if not (np.isfinite(stylized).all() and np.isfinite(photo).all()):
        raise InvalidValue("values of an image are not finite")
    everywhere = np.ones(photo.shape[:2], bool) if mask is None else np.asarray(mask, bool)
    wanted, wanted_bins = _edges(photo, everywhere)
    if not wanted.any():
        raise InvalidValue("the photo has no edges that could be kept")
    found, found_bins = _edges(stylized, everywhere)
    reach = max(1.0, TOLERANCE * max(photo.shape[:2]))
    met, chance = 0, 0.0
    for orientation in range(BINS):
        own = wanted & (wanted_bins == orientation)
        turned = (found_bins - orientation) % BINS
        near = _within(found & ((turned <= 1) | (turned == BINS - 1)), reach)
        met += int(near[own].sum())
        chance += float(own.sum() * near[everywhere].mean())
    total = float(wanted.sum())
    if chance >= total:
        return 0.0
    return float(np.clip((met - chance) / (total - chance), 0, 1))


def _edges(image: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return edge pixels [h, w] bool, and the bin of the gradient's orientation at every pixel."""
    luma = luminance(image)
    luma = (luma - luma[mask].mean()) / max(float(luma[mask].std()), LEAST_SPREAD) if mask.any() else luma * 0
    sigma = max(1.0, SIGMA * max(luma.shape))
    slope = min(1.0, SIDE / max(luma.shape))
    inside = None if mask.all() else mask
    edges = canny(luma, sigma=sigma, low_threshold=LOW * slope, high_threshold=HIGH * slope, mask=inside)
    right, down = (gaussian_filter(luma, sigma, order=order) for order in ((0, 1), (1, 0)))
    bins = np.floor((np.arctan2(down, right) % np.pi) / np.pi * BINS).astype(int) % BINS
    return edges, bins


def _within(places: np.ndarray, reach: float) -> np.ndarray:
    """Return the pixels at most `reach` pixels from any of `places` [h, w]."""
    return distance_transform_edt(~places) <= reach if places.any() else np.zeros_like(places)
