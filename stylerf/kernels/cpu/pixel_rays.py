"""Rays and target colors of chosen pixels, computed from cameras and 8-bit images: rays are never stored."""

import math

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import parallel_kernel

_ONE = np.float32(1)
_BYTE = np.float32(1.0 / 255.0)


@parallel_kernel
def gather(views, pixels, widths, intrinsics, poses, starts, bytes_, channels, codes, origins, directions, colors):
    """Fill ray r from pixel pixels[r] (row-major) of view views[r].

    Args:
        intrinsics: [views, 4], fx fy cx cy, pixels.
        poses: [views, 3, 4], world from camera (OpenCV axes).
        starts: [views], offset of a view's first byte in bytes_.
        codes: [views, 256], the color that a byte of a view stands for.
        colors: [rays, 4], written: rgb and alpha 0..1 (alpha 1 for images of three channels).
    """
    for r in prange(len(views)):
        v = views[r]
        i = pixels[r] % widths[v]
        j = pixels[r] // widths[v]
        x = (np.float32(i) + np.float32(0.5) - intrinsics[v, 2]) / intrinsics[v, 0]
        y = (np.float32(j) + np.float32(0.5) - intrinsics[v, 3]) / intrinsics[v, 1]
        norm = _ONE / np.float32(math.sqrt(x * x + y * y + _ONE))
        for a in range(3):
            directions[r, a] = (poses[v, a, 0] * x + poses[v, a, 1] * y + poses[v, a, 2]) * norm
            origins[r, a] = poses[v, a, 3]
        at = starts[v] + pixels[r] * channels
        for a in range(3):
            colors[r, a] = codes[v, bytes_[at + a]]
        colors[r, 3] = np.float32(bytes_[at + 3]) * _BYTE if channels == 4 else _ONE
