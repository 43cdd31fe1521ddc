"""Deep OpenEXR files: per pixel a list of samples with depth, end of depth, color and alpha.

Channels: R G B A half, of the sample alone and premultiplied by its own alpha; Z and ZBack float32, planar depth. One
deep scanline part with ZIPS compression (OpenEXR: Interpreting Deep Pixels).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenEXR

from schemas.exr import ExrView, view_attributes, write_part

_TINY = np.float32(1e-7)


@dataclass(frozen=True, eq=False)
class DeepSamples:
    """Samples of a view: pixels row by row, the samples of each pixel front to back.

    Attributes:
        counts: [h, w], samples of each pixel.
        z, z_back: [n], planar depth, scene units, z <= z_back <= z of the pixel's next.
        rgb: [n, 3], the part of the flat pixel's premultiplied color that the sample adds, linear.
        weights: [n], the part of the flat pixel's alpha that it adds.
    """

    counts: np.ndarray
    z: np.ndarray
    z_back: np.ndarray
    rgb: np.ndarray
    weights: np.ndarray


def write_deep_exr(path: Path | str, view: ExrView, samples: DeepSamples) -> None:
    """Write samples atomically, with the header of the flat `view`; equal arguments give equal bytes.

    Raises:
        ValueError: Arrays differ in size or hold NaN or infinity.
        OutOfResources: The disk is full or read-only.
    """
    count = int(samples.counts.sum())
    for name, values in (("Z", samples.z), ("ZBack", samples.z_back), ("A", samples.weights), ("color", samples.rgb)):
        if len(values) != count or not np.isfinite(values).all():
            raise ValueError(
                f"deep EXR: {name} has {len(values)} values, expected {count}, or contains NaN or infinity"
            )
    alpha, rgb = _own_alpha_and_color(samples)
    flat = {"R": rgb[:, 0], "G": rgb[:, 1], "B": rgb[:, 2], "A": alpha}
    flat |= {"Z": samples.z.astype(np.float32), "ZBack": samples.z_back.astype(np.float32)}
    channels = {name: _by_pixel(np.ascontiguousarray(values), samples.counts) for name, values in flat.items()}
    header = {"compression": OpenEXR.ZIPS_COMPRESSION, "type": OpenEXR.deepscanline, **view_attributes(view)}
    write_part(Path(path), header, channels, sum(values.nbytes for values in flat.values()))


def _own_alpha_and_color(samples: DeepSamples) -> tuple[np.ndarray, np.ndarray]:
    """Return alpha [n] and premultiplied color [n, 3] of the samples alone, half.

    w_k = T_k a_k, with the transmittance T_k of the rounded alphas in front: rounding errors do not add up.
    """
    counts = samples.counts.reshape(-1)
    starts = np.cumsum(counts) - counts
    alpha = np.zeros(len(samples.weights), np.float16)
    rgb = np.zeros((len(samples.weights), 3), np.float16)
    left, wanted = np.ones(len(counts)), np.ones(len(counts))  # transmittance of rounded and of exact alphas
    for rank in range(int(counts.max(initial=0))):
        pixels = np.flatnonzero(counts > rank)
        at = starts[pixels] + rank
        wanted[pixels] -= samples.weights[at]
        before = np.maximum(left[pixels], _TINY)
        alpha[at] = np.clip(1 - np.maximum(wanted[pixels], 0) / before, 0, 1)
        shown = np.clip(samples.rgb[at] / before[:, None], 0, None)
        rgb[at] = np.where((left[pixels] > _TINY)[:, None], np.minimum(shown, np.finfo(np.float16).max), 0)
        left[pixels] *= 1 - alpha[at].astype(np.float64)
    return alpha, rgb


def _by_pixel(values: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Return [h, w] objects: the array of each pixel's values, None if it has none."""
    out = np.empty(counts.size, object)
    ends = np.cumsum(counts.reshape(-1))
    out[0] = values[:0]  # without any array, OpenEXR would not know the channel's type
    for pixel in np.flatnonzero(counts):
        out[pixel] = values[ends[pixel] - counts.flat[pixel] : ends[pixel]]
    return out.reshape(counts.shape)
