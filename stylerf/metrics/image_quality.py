"""Mean squared error, PSNR and SSIM of two images, optionally masked, and the shift between them.

Images are float arrays [h, w, 3] or [h, w], sRGB 0..1. NaN and infinity raise InvalidValue. Nothing here is
differentiable.
"""

import numpy as np
from scipy.ndimage import gaussian_filter

from stylerf.errors import InvalidValue
from stylerf.srgb import LUMA

SSIM_WINDOW = 11  # pixels: a Gaussian with sigma 1.5, truncated at 3.5 sigma
SSIM_SIGMA = 1.5
STRUCTURE_SIGMA = 0.05  # of the longer side
CODE_VALUE = 1 / 255  # standard deviation below which an image counts as flat


def mse(a: np.ndarray, b: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Return the mean of (a - b)^2 over pixels and channels, weighted by `mask` [h, w] (bool or >= 0) if given."""
    _check_pair(a, b)
    squared = (np.asarray(a, np.float64) - np.asarray(b, np.float64)) ** 2
    per_pixel = squared.mean(axis=-1) if squared.ndim == 3 else squared
    return _masked_mean(per_pixel, mask)


def psnr(a: np.ndarray, b: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Return -10 log10(MSE), dB; infinite for equal images."""
    error = mse(a, b, mask)
    return float("inf") if error == 0 else -10.0 * float(np.log10(error))


def ssim_map(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the structural similarity at each pixel, [h, w], averaged over channels, -1..1.

    Protocol of Wang et al. 2004: Gaussian window 11x11, sigma 1.5, K1 = 0.01, K2 = 0.03, population covariance,
    data range 1. The image is mirrored at its border; ssim() excludes those 5 pixels.
    """
    _check_pair(a, b)
    if min(a.shape[:2]) < SSIM_WINDOW:
        raise InvalidValue(f"SSIM needs images of at least {SSIM_WINDOW}x{SSIM_WINDOW} pixels, not {a.shape[:2]}")
    from skimage.metrics import structural_similarity  # late import: fits use this module but no SSIM

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
    return np.asarray(full.mean(axis=-1) if full.ndim == 3 else full)


def ssim(a: np.ndarray, b: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Return the mean of ssim_map() without its 5-pixel border, weighted by `mask` [h, w] if given.

    Windows centered in the mask extend up to 5 pixels beyond it.
    """
    border = SSIM_WINDOW // 2
    inner = (slice(border, -border), slice(border, -border))
    return _masked_mean(ssim_map(a, b)[inner], None if mask is None else np.asarray(mask)[inner])


def luminance(image: np.ndarray) -> np.ndarray:
    """Return the Rec.709 luma [h, w], 0..1, of an image [h, w, 3], computed from encoded values."""
    return np.asarray(image, np.float64) @ LUMA


def content_ssim(stylized: np.ndarray, photo: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Return the luma SSIM of a stylized render and the photo: the structure kept, regardless of colors."""
    return ssim(luminance(stylized), luminance(photo), mask)


def explained_structure(stylized: np.ndarray, photo: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Return the fraction, 0..1, of the photo's local luma variance explained by a local linear fit to the render.

    Local means a Gaussian with sigma STRUCTURE_SIGMA times the longer side. With local variances v_p, v_r and
    covariance c of the two lumas, the best line leaves v_p - c^2 / v_r unexplained; the result is the sum of c^2 / v_r
    over that of v_p, weighted by `mask`. Negative slopes count too: inverted structure is still visible. Where the
    photo is smooth, there is no variance to explain, so brush strokes there cost nothing.
    """
    _check_pair(stylized, photo)
    sigma = STRUCTURE_SIGMA * max(photo.shape[:2])

    def around(values: np.ndarray) -> np.ndarray:
        return gaussian_filter(values, sigma, truncate=3.5)

    render, wanted = luminance(stylized), luminance(photo)
    mean_render, mean_wanted = around(render), around(wanted)
    covariance = around(render * wanted) - mean_render * mean_wanted
    of_render = np.maximum(around(render**2) - mean_render**2, 0)  # E[x^2] - E[x]^2 can round below 0
    of_wanted = np.maximum(around(wanted**2) - mean_wanted**2, 0)
    # c^2 <= v_r v_p (Cauchy-Schwarz) up to rounding; CODE_VALUE keeps the noise of a flat render from explaining much.
    explained = np.minimum(covariance**2 / (of_render + CODE_VALUE**2), of_wanted)
    return _masked_mean(explained, mask) / (_masked_mean(of_wanted, mask) + CODE_VALUE**2)


def _check_pair(a: np.ndarray, b: np.ndarray) -> None:
    if a.shape != b.shape or a.ndim not in (2, 3) or a.size == 0:
        raise InvalidValue(f"expected two images of one size, got {a.shape} and {b.shape}")
    for image in (a, b):
        if not np.isfinite(image).all():
            raise InvalidValue(f"{int((~np.isfinite(image)).sum())} values of an image are not finite")


def _masked_mean(values: np.ndarray, mask: np.ndarray | None) -> float:
    """Return the mean of values [h, w], weighted by the mask if given."""
    if mask is None:
        return float(values.mean())
    weights = np.asarray(mask, np.float64)
    if weights.shape != values.shape:
        raise InvalidValue(f"mask of shape {weights.shape} does not fit an image of {values.shape}")
    total = weights.sum()
    if not total > 0 or weights.min() < 0:
        raise InvalidValue("mask weights must not be negative, and at least one must be positive")
    return float((values * weights).sum() / total)


FINEST, COARSEST = 1.0, 8.0  # band-pass: standard deviations of the two Gaussians, pixels
LARGEST_SHARE = 1 / 3  # maximum shift, as a fraction of the shorter side


def shift_between(one: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, float]:
    """Estimate the shift from `one` to `other`, [h, w] each.

    The peak of the cross-correlation of the band-passed images, refined to subpixels by a parabola. Symmetric blur
    flattens the peak but does not move it.

    Returns:
        The shift (right, down), pixels, and the correlation at the peak, -1..1; zeros if an image is uniform.
    """
    height, width = one.shape
    # Fades out towards the borders, where the images show different content.
    window = np.sqrt(np.outer(np.hanning(height + 2), np.hanning(width + 2)))[1:-1, 1:-1]
    one, other = (_detail(picture, window) for picture in (one, other))
    most = max(1, int(min(height, width) * LARGEST_SHARE))
    # Zero padding, so that the circular correlation does not wrap around.
    size = 2 * height + 4, 2 * width + 4
    energy = float(np.sqrt(np.square(one).sum() * np.square(other).sum()))
    if energy <= 1e-9:
        return np.zeros(2), 0.0
    products = np.fft.irfft2(np.fft.rfft2(one, size).conj() * np.fft.rfft2(other, size), size)
    # Shifts -most - 1 to most + 1 in order; the outermost are only neighbors for the parabola.
    near = np.roll(products, (most + 1, most + 1), axis=(0, 1))[: 2 * most + 3, : 2 * most + 3]
    row, column = np.unravel_index(near[1:-1, 1:-1].argmax(), (2 * most + 1, 2 * most + 1))
    down = row - most + _vertex(near[row : row + 3, column + 1])
    right = column - most + _vertex(near[row + 1, column : column + 3])
    return np.array([right, down]), float(near[row + 1, column + 1]) / energy


def _detail(picture: np.ndarray, window: np.ndarray) -> np.ndarray:
    """Return a band-passed and windowed image with mean 0."""
    picture = np.asarray(picture, np.float64)
    detail = gaussian_filter(picture, FINEST) - gaussian_filter(picture, COARSEST)
    return (detail - (detail * window).sum() / window.sum()) * window


def _vertex(values: np.ndarray) -> float:
    """Return the vertex, -1/2..1/2 from the middle, of the parabola through three values, the middle one largest."""
    before, middle, after = values
    bend = before - 2 * middle + after
    return float(np.clip(0.5 * (before - after) / bend, -0.5, 0.5)) if bend < 0 else 0.0
