"""Masks of regions: the part of each ray's opacity inside marked cells of the cube."""

import numpy as np

from stylerf.fields.ray_samples import Samples
from stylerf.kernels.cpu.regions import weights_inside


def alpha_inside(marked: np.ndarray, samples: Samples, chunks: int) -> np.ndarray:
    """Return the sum of each ray's weights over samples in marked cells [s, s, s], [rays] float32."""
    out = np.zeros(len(samples.ends), np.float32)
    flat = np.ascontiguousarray(marked).reshape(-1)
    weights_inside(flat, marked.shape[0], samples.x, samples.weights, samples.starts, samples.ends, chunks, out)
    return out
