"""Deep frames: samples along each ray in linear light, which flatten to the flat frame."""

import numpy as np

from schemas.color_spaces import COLOR_SPACES, REC709, matrix_between
from schemas.deep_exr import DeepSamples
from schemas.exr import ExrView
from schemas.images import linear_from_srgb
from stages.compositing.exr_views import in_space
from stylerf.rendering.deep import DeepView

_TINY = 1e-6


def deep_samples(deep: DeepView, flat: ExrView) -> DeepSamples:
    """Convert a deep view to linear light of the flat view's color space.

    Fields blend sRGB-encoded colors along a ray, compositors add light: the samples' linear colors are scaled, per
    pixel and channel, so that their sum is the flat pixel's color. The sRGB curve is convex, so the factor is at most 1
    (but for a color map's clipping).
    """
    counts = deep.counts.reshape(-1)
    pixel = np.repeat(np.arange(len(counts)), counts)
    straight = np.clip(deep.rgb / np.maximum(deep.weights[:, None], _TINY), 0, 1)
    light = linear_from_srgb(straight) * deep.weights[:, None]
    target = _in_rec709(flat).reshape(-1, 3)
    alpha = np.maximum(flat.alpha.reshape(-1, 1), _TINY)
    total = np.stack([np.bincount(pixel, light[:, a], len(counts)) for a in range(3)], axis=-1)
    dark = total <= _TINY * alpha  # nothing to scale: every sample gets the pixel's own color
    scale = np.where(dark, 0, target / np.maximum(total, _TINY * _TINY))
    rgb = light * scale[pixel] + deep.weights[:, None] * np.where(dark, target / alpha, 0)[pixel]
    rgb = in_space(rgb.astype(np.float32), flat.colorspace)
    return DeepSamples(deep.counts, deep.z, deep.z_back, rgb, deep.weights)


def _in_rec709(flat: ExrView) -> np.ndarray:
    space = COLOR_SPACES[flat.colorspace]
    return flat.rgb if space == REC709 else flat.rgb @ matrix_between(space, REC709).T
