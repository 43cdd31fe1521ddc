"""sRGB code values and linear light (IEC 61966-2-1), both 0..1."""

import numpy as np

LUMA = np.array([0.2126, 0.7152, 0.0722])  # Rec.709


def decoded(values: np.ndarray) -> np.ndarray:
    """Decode sRGB code values to linear light."""
    return np.where(values <= 0.04045, values / 12.92, ((np.maximum(values, 0.04045) + 0.055) / 1.055) ** 2.4)


def encoded(linear: np.ndarray) -> np.ndarray:
    """Encode linear light as sRGB code values."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)


def codes_at(stops: np.ndarray) -> np.ndarray:
    """Return the correctly exposed code value of every byte, [photos, 256] float32, 0..1.

    Args:
        stops: Overexposure of each photo, [photos].
    """
    bytes_ = np.arange(256, dtype=np.float32) * np.float32(1 / 255)
    codes = np.repeat(bytes_[None], len(stops), 0)
    for photo in np.flatnonzero(stops):
        codes[photo] = exposed(np.repeat(bytes_[:, None], 3, 1), -stops[photo])[:, 0]
    return codes


def exposed(photo: np.ndarray, stops: float) -> np.ndarray:
    """Multiply the light of an sRGB photo [h, w, 3 or 4] by 2^stops and clip at white; alpha is unchanged."""
    out = photo.copy()
    out[..., :3] = encoded(np.minimum(decoded(photo[..., :3].astype(np.float64)) * 2.0**stops, 1.0))
    return out
