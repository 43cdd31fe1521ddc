"""HDR video (BT.2100) to 8-bit sRGB by one fixed curve, so that all frames of a clip are treated alike."""

import numpy as np

from schemas.images import srgb_from_linear, to_uint8

PQ, HLG = 16, 18  # transfer characteristics of ITU-T H.273
REFERENCE_WHITE = 203.0  # cd/m2 of a white page in HDR, ITU-R BT.2408
PEAK = 1000.0  # cd/m2 that is mapped to 1
KNEE = 0.75  # of the reference white: linear below, compressed above
# Linear BT.2020 to linear BT.709, ITU-R BT.2087.
_709_FROM_2020 = np.array(
    [[1.660491, -0.587641, -0.072850], [-0.124550, 1.132900, -0.008349], [-0.018151, -0.100579, 1.118730]], np.float32
)


def sdr_from_hdr(coded: np.ndarray, transfer: int) -> np.ndarray:
    """Convert BT.2020 code values to sRGB.

    Light relative to the reference white is kept up to KNEE; above, its largest channel is compressed to 1 at PEAK, and
    all channels by the same factor, which keeps hues.

    Args:
        coded: [h, w, 3] uint16, full range, in BT.2020 primaries.
        transfer: PQ or HLG.

    Returns:
        [h, w, 3] uint8, sRGB.
    """
    values = coded.astype(np.float32) / 65535
    light = (light_of_pq(values) if transfer == PQ else light_of_hlg(values)) / REFERENCE_WHITE
    light = np.maximum(light @ _709_FROM_2020.T, 0)
    largest = light.max(axis=-1, keepdims=True)
    light *= compressed(largest) / np.maximum(largest, 1e-6)
    return to_uint8(srgb_from_linear(light).clip(0, 1))


def light_of_pq(coded: np.ndarray) -> np.ndarray:
    """Return the light, cd/m2, of PQ code values 0..1 (SMPTE ST 2084)."""
    m1, m2, c1, c2, c3 = 1305 / 8192, 2523 / 32, 107 / 128, 2413 / 128, 2392 / 128
    powered = np.maximum(coded, 0) ** (1 / m2)
    light: np.ndarray = 10_000 * (np.maximum(powered - c1, 0) / (c2 - c3 * powered)) ** (1 / m1)
    return light


def light_of_hlg(coded: np.ndarray) -> np.ndarray:
    """Return the light, cd/m2, of HLG code values [..., 3], 0..1, on a display of PEAK (ITU-R BT.2100, gamma 1.2)."""
    a, b, c = 0.17883277, 0.28466892, 0.55991073
    scene = np.where(coded <= 0.5, coded * coded / 3, (np.exp((coded - c) / a) + b) / 12)
    luminance = scene @ np.array([0.2627, 0.6780, 0.0593], np.float32)
    light: np.ndarray = PEAK * scene * np.maximum(luminance, 1e-9)[..., None] ** 0.2
    return light


def compressed(light: np.ndarray) -> np.ndarray:
    """Return light, relative to the reference white, mapped to 0..1: slope 1 up to KNEE, 1 at PEAK and beyond."""
    most = (PEAK / REFERENCE_WHITE - KNEE) / (1 - KNEE)
    over = np.clip((light - KNEE) / (1 - KNEE), 0, most)
    # Reinhard et al. 2002, equation 4, of what exceeds the knee.
    found: np.ndarray = np.minimum(light, KNEE) + (1 - KNEE) * over * (1 + over / most**2) / (1 + over)
    return found
