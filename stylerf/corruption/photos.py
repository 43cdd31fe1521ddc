"""Faults of photos: drifting exposure, blur, JPEG artifacts.

Photos are [h, w, 3 or 4] float32, sRGB 0..1, with straight alpha, which only blur changes.
"""

import io

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter


def exposure_stops(count: int, stops: float, generator: np.random.Generator) -> np.ndarray:
    """Return the overexposure of `count` consecutive photos, in stops, [count].

    A ramp from -stops to stops or, randomly, the reverse, as when the sun comes out.
    """
    return float(generator.choice([-1, 1])) * np.linspace(-stops, stops, count)


def blurred(photo: np.ndarray, sigma: float) -> np.ndarray:
    """Blur premultiplied colors and alpha with a Gaussian of `sigma` pixels, mirrored at the edges."""
    sigmas = (sigma, sigma, 0)
    if photo.shape[2] == 3:
        return np.clip(gaussian_filter(photo, sigmas, mode="reflect"), 0, 1)
    alpha = photo[..., 3:]
    mixed = gaussian_filter(np.concatenate([photo[..., :3] * alpha, alpha], -1), sigmas, mode="reflect")
    rgb = mixed[..., :3] / np.maximum(mixed[..., 3:], 1e-6)
    return np.clip(np.concatenate([rgb, mixed[..., 3:]], -1), 0, 1)


def through_jpeg(photo: np.ndarray, quality: int) -> np.ndarray:
    """Compress the colors as JPEG of this quality (1..95, 4:2:0) and decode them."""
    stored = io.BytesIO()
    pixels = np.round(np.clip(photo[..., :3], 0, 1) * 255).astype(np.uint8)
    Image.fromarray(pixels).save(stored, format="JPEG", quality=quality, subsampling=2)
    out = photo.copy()
    out[..., :3] = np.asarray(Image.open(stored), np.float32) / 255
    return out
