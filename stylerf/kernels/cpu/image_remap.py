"""Image resampling at arbitrary positions by Catmull-Rom interpolation."""

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import inline, parallel_kernel


@inline
def _cubic(t):
    """Catmull-Rom weights of the four neighbors at offset t in 0..1 from the second (Keys 1981, a = -1/2)."""
    return (
        ((-0.5 * t + 1.0) * t - 0.5) * t,
        (1.5 * t - 2.5) * t * t + 1.0,
        ((-1.5 * t + 2.0) * t + 0.5) * t,
        (0.5 * t - 0.5) * t * t,
    )


@parallel_kernel
def remapped(pixels, positions):
    """Sample a picture [h, w, c] float32 at positions [a, b, 2]: [a, b, c], clipped to 0..1.

    Positions are (x, y), pixel centers at halves. Beyond the border the nearest pixel counts.
    """
    height, width, channels = pixels.shape
    out = np.empty((positions.shape[0], positions.shape[1], channels), np.float32)
    for i in prange(positions.shape[0]):
        for j in range(positions.shape[1]):
            x, y = positions[i, j, 0] - np.float32(0.5), positions[i, j, 1] - np.float32(0.5)
            left, top = int(np.floor(x)), int(np.floor(y))
            wx, wy = _cubic(x - left), _cubic(y - top)
            for c in range(channels):
                total = np.float32(0)
                for a in range(4):
                    row = min(max(top - 1 + a, 0), height - 1)
                    line = np.float32(0)
                    for b in range(4):
                        line += np.float32(wx[b]) * pixels[row, min(max(left - 1 + b, 0), width - 1), c]
                    total += np.float32(wy[a]) * line
                out[i, j, c] = min(max(total, np.float32(0)), np.float32(1))
    return out
