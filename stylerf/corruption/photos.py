"""Faults of photos: exposure that drifts, blur, JPEG noise.

Photos are [h, w, 3 or 4] float32, sRGB 0..1, straight alpha, which no fault but blur changes.
"""

import io

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter


def exposure_stops(count: int, stops: float, generator: np.random.Generator) -> np.ndarray:
    """[count] stops by which photos in the order of their taking are over- or under-exposed.

    A ramp from -stops to stops or the other way round, as when the sun comes out, by chance.
    """
    return float(generator.choice([-1, 1])) * np.linspace(-stops, stops, count)


def blurred(photo: np.ndarray, sigma: float) -> np.ndarray:
    """The photo out of focus: a Gaussian of `sigma` pixels over premultiplied colors and alpha, edges mirrored."""
    sigmas = (sigma, sigma, 0)
    if photo.shape[2] == 3:
        return np.clip(gaussian_filter(photo, sigmas, mode="reflect"), 0, 1)
    alpha = photo[..., 3:]
    mixed = gaussian_filter(np.concatenate([photo[..., :3] * alpha, alpha], -1), sigmas, mode="reflect")
    rgb = mixed[..., :3] / np.maximum(mixed[..., 3:], 1e-6)
    return np.clip(np.concatenate([rgb, mixed[..., 3:]], -1), 0, 1)


def through_jpeg(photo: np.ndarray, quality: int) -> np.ndarray:
    """The colors as a JPEG file of that quality (1..95, chroma halved) gives them back."""
    stored = io.BytesIO()
    pixels = np.round(np.clip(photo[..., :3], 0, 1) * 255).astype(np.uint8)
    Image.fromarray(pixels).save(stored, format="JPEG", quality=quality, subsampling=2)
    out = photo.copy()
    out[..., :3] = np.asarray(Image.open(stored), np.float32) / 255
    return out
