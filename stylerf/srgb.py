"""sRGB code values and the light they stand for (IEC 61966-2-1), 0..1 both."""

import numpy as np

LUMA = np.array([0.2126, 0.7152, 0.0722])  # weights of Rec.709


def decoded(values: np.ndarray) -> np.ndarray:
    """Linear light of sRGB code values."""
    return np.where(values <= 0.04045, values / 12.92, ((np.maximum(values, 0.04045) + 0.055) / 1.055) ** 2.4)


def encoded(light: np.ndarray) -> np.ndarray:
    """sRGB code values of linear light."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 0.0031308) ** (1 / 2.4) - 0.055)


def codes_at(stops: np.ndarray) -> np.ndarray:
    """[photos, 256] float32: value that each byte stands for in photos overexposed by stops [photos]; at most 1."""
    bytes_ = np.arange(256, dtype=np.float32) * np.float32(1 / 255)
    codes = np.repeat(bytes_[None], len(stops), 0)
    for photo in np.flatnonzero(stops):
        codes[photo] = exposed(np.repeat(bytes_[:, None], 3, 1), -stops[photo])[:, 0]
    return codes


def exposed(photo: np.ndarray, stops: float) -> np.ndarray:
    """The photo [h, w, 3 or 4], sRGB, with its light multiplied by 2^stops and clipped at white; alpha stays."""
    out = photo.copy()
    out[..., :3] = encoded(np.minimum(decoded(photo[..., :3].astype(np.float64)) * 2.0**stops, 1.0))
    return out
