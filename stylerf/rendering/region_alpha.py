"""How much of a ray's opacity lies in marked cells of the cube: the masks of regions."""

import numpy as np

from stylerf.kernels.cpu.ray_samples import Samples
from stylerf.kernels.cpu.regions import weights_inside


def alpha_inside(marked: np.ndarray, samples: Samples, chunks: int) -> np.ndarray:
    """[rays] float32: sum of each ray's weights over samples in marked cells [s, s, s]."""
    out = np.zeros(len(samples.ends), np.float32)
    flat = np.ascontiguousarray(marked).reshape(-1)
    weights_inside(flat, marked.shape[0], samples.shading_points(), chunks, out)
    return out
