"""How far one image is from another: mean squared error, PSNR, SSIM, whole or under a mask.

Images are float arrays [h, w, 3] (or [h, w]) with values in 0..1, sRGB-encoded unless the name says linear. Nothing
here is differentiable. A value that is not finite is refused, never averaged away.
"""

import numpy as np
from scipy.ndimage import gaussian_filter
from skimage.metrics import structural_similarity

from stylerf.errors import InvalidValue
from stylerf.srgb import LUMA

SSIM_WINDOW = 11  # pixels: what a Gaussian of sigma 1.5 cut at 3.5 sigma covers
SSIM_SIGMA = 1.5
STRUCTURE_SIGMA = 0.05  # of the longer side
CODE_VALUE = 1 / 255  # spread below which a picture counts as flat


def mse(a: np.ndarray, b: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Mean of (a - b)^2 over pixels and channels; with `mask` [h, w] (bool or weights >= 0) the weighted mean."""
    _check_pair(a, b)
    squared = (np.asarray(a, np.float64) - np.asarray(b, np.float64)) ** 2
    per_pixel = squared.mean(axis=-1) if squared.ndim == 3 else squared
    return _masked_mean(per_pixel, mask)


def psnr(a: np.ndarray, b: np.ndarray, mask: np.ndarray | None = None) -> float:
    """-10 log10(MSE) in dB for values in 0..1; infinite for equal images."""
    error = mse(a, b, mask)
    return float("inf") if error == 0 else -10.0 * float(np.log10(error))


def ssim_map(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Structural similarity at each pixel, [h, w], mean over channels, -1..1.

    Protocol of Wang et al. 2004: Gaussian window 11x11, sigma 1.5, K1 = 0.01, K2 = 0.03, population covariance,
    data range 1. Within 5 pixels of the border the window is mirrored; `ssim` leaves that border out.
    """
    _check_pair(a, b)
    if min(a.shape[:2]) < SSIM_WINDOW:
        raise InvalidValue(f"SSIM needs images of at least {SSIM_WINDOW}x{SSIM_WINDOW} pixels, not {a.shape[:2]}")
    _, full = structural_similarity(
        np.asarray(a, np.float64),
        np.asarray(b, np.float64),
        gaussian_weights=True,
        sigma=SSIM_SIGMA,
        use_sample_covariance=False,
        data_range=1.0,
        channel_axis=-1 if a.ndim == 3 else None,
        full=True,
    )
    return full.mean(axis=-1) if full.ndim == 3 else full


def ssim(a: np.ndarray, b: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Mean of `ssim_map` without its 5-pixel border; with `mask` [h, w] the weighted mean over what is left.

    Windows centerd in the mask still see up to 5 pixels beyond it.
    """
    border = SSIM_WINDOW // 2
    inner = (slice(border, -border), slice(border, -border))
    return _masked_mean(ssim_map(a, b)[inner], None if mask is None else np.asarray(mask)[inner])


def luminance(image: np.ndarray) -> np.ndarray:
    """Rec.709 luma of an sRGB-encoded image [h, w, 3] -> [h, w], 0..1 (weights applied to the encoded values)."""
    return np.asarray(image, np.float64) @ LUMA


def content_ssim(stylized: np.ndarray, photo: np.ndarray, mask: np.ndarray | None = None) -> float:
    """SSIM between the luma of a stylized render and of the photo: how much of the structure survived, color aside."""
    return ssim(luminance(stylized), luminance(photo), mask)


def explained_structure(stylized: np.ndarray, photo: np.ndarray, mask: np.ndarray | None = None) -> float:
    """0..1: share of the variance of the photo's luma around each pixel that the render's luma there explains.

    Around a pixel: a Gaussian of sigma STRUCTURE_SIGMA of the longer side. With variances v_p, v_r and covariance c of
    the two lumas there, a straight line from the render's to the photo's leaves v_p - c^2 / v_r unexplained; sums of
    c^2 / v_r and of v_p over all pixels (weighted by `mask`) make the share. A line may fall: what was light and
    became dark is still to be seen. Where the photo is smooth nothing is asked for; strokes there cost nothing.
    """
    _check_pair(stylized, photo)
    sigma = STRUCTURE_SIGMA * max(photo.shape[:2])

    def around(values: np.ndarray) -> np.ndarray:
        return gaussian_filter(values, sigma, truncate=3.5)

    render, wanted = luminance(stylized), luminance(photo)
    mean_render, mean_wanted = around(render), around(wanted)
    covariance = around(render * wanted) - mean_render * mean_wanted
    of_render = np.maximum(around(render**2) - mean_render**2, 0)
    of_wanted = np.maximum(around(wanted**2) - mean_wanted**2, 0)
    explained = np.minimum(covariance**2 / (of_render + CODE_VALUE**2), of_wanted)
    return _masked_mean(explained, mask) / (_masked_mean(of_wanted, mask) + CODE_VALUE**2)


def _check_pair(a: np.ndarray, b: np.ndarray) -> None:
    if a.shape != b.shape or a.ndim not in (2, 3) or a.size == 0:
        raise InvalidValue(f"expected two images of one size, got {a.shape} and {b.shape}")
    for image in (a, b):
        if not np.isfinite(image).all():
            raise InvalidValue(f"{int((~np.isfinite(image)).sum())} values of an image are not finite")


def _masked_mean(values: np.ndarray, mask: np.ndarray | None) -> float:
    """Mean of [h, w] values, weighted by the mask where there is one."""
    if mask is None:
        return float(values.mean())
    weights = np.asarray(mask, np.float64)
    if weights.shape != values.shape:
        raise InvalidValue(f"mask of shape {weights.shape} does not fit an image of {values.shape}")
    total = weights.sum()
    if not total > 0 or weights.min() < 0:
        raise InvalidValue("a mask needs weights that are not negative and at least one above zero")
    return float((values * weights).sum() / total)
