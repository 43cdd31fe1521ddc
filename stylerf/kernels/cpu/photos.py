"""Kernels on photos: rays of pixels, resampling, and cells of space ruled out by masks."""

import math
from typing import NamedTuple

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import inline, parallel_kernel

_ONE = np.float32(1)
_BYTE = np.float32(1.0 / 255.0)


class Photos(NamedTuple):
    """Concatenated 8-bit photos and their cameras.

    Attributes:
        values: [sum of h w channels] uint8.
        channels: 3 or 4 (straight alpha).
        starts: [views], offset of each view's first byte in `values`.
        widths: [views], pixels.
        intrinsics: [views, 4], fx fy cx cy, pixels.
        poses: [views, 3, 4], world from camera (OpenCV axes).
        codes: [views, 256], color of each byte value in a view.
    """

    values: np.ndarray
    channels: int
    starts: np.ndarray
    widths: np.ndarray
    intrinsics: np.ndarray
    poses: np.ndarray
    codes: np.ndarray


@parallel_kernel
def gather(photos, views, pixels, origins, directions, colors):
    """Compute ray r from pixel pixels[r] (row-major) of view views[r]; rays are never stored.

    colors: output, [rays, 4]: rgb and alpha 0..1 (alpha 1 for images with three channels).
    """
    values, channels, starts, widths = photos.values, photos.channels, photos.starts, photos.widths
    intrinsics, poses, codes = photos.intrinsics, photos.poses, photos.codes
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
            colors[r, a] = codes[v, values[at + a]]
        colors[r, 3] = np.float32(values[at + 3]) * _BYTE if channels == 4 else _ONE


@inline
def _cubic(t):
    """Return Catmull-Rom weights of the four neighbors at offset t in 0..1 from the second (Keys 1981, a = -1/2)."""
    return (
        ((-0.5 * t + 1.0) * t - 0.5) * t,
        (1.5 * t - 2.5) * t * t + 1.0,
        ((-1.5 * t + 2.0) * t + 0.5) * t,
        (0.5 * t - 0.5) * t * t,
    )


@parallel_kernel
def remapped(pixels, positions):
    """Sample an image [h, w, c] float32 at positions [a, b, 2]: [a, b, c], clipped to 0..1.

    Positions are (x, y), pixel centers at halves. Beyond the border, the nearest pixel is used.
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
                # The outer two weights are negative, so the sum overshoots at sharp edges.
                out[i, j, c] = min(max(total, np.float32(0)), np.float32(1))
    return out


@parallel_kernel
def count_clear(sums, pose, fx, fy, cx, cy, low, width, cells, radius, threads, seen, clear):
    """Add 1 to seen[cell] if a cell's ball projects into the image, to clear[cell] if no pixel is marked there.

    Args:
        sums: [h + 1, w + 1] int32, summed-area table of the image's marks.
        pose: [3, 4] float32, world from camera.
        low, width: [3] float32, the box's lower corner and the sides of its cells.
        radius: of a cell's bounding ball.
    """
    height, length = sums.shape[0] - 1, sums.shape[1] - 1
    for thread in prange(threads):
        for i in range(thread * cells // threads, (thread + 1) * cells // threads):
            x = low[0] + (np.float32(i) + np.float32(0.5)) * width[0] - pose[0, 3]
            for j in range(cells):
                y = low[1] + (np.float32(j) + np.float32(0.5)) * width[1] - pose[1, 3]
                for k in range(cells):
                    z = low[2] + (np.float32(k) + np.float32(0.5)) * width[2] - pose[2, 3]
                    depth = x * pose[0, 2] + y * pose[1, 2] + z * pose[2, 2]
                    # A ball that touches the camera plane has an unbounded projection.
                    if depth <= radius:
                        continue
                    u = (x * pose[0, 0] + y * pose[1, 0] + z * pose[2, 0]) / depth
                    v = (x * pose[0, 1] + y * pose[1, 1] + z * pose[2, 1]) / depth
                    # A ball projects to an ellipse, which is longer farther off the optical axis; this is its bound.
                    reach = radius * (np.float32(1) + u * u + v * v) / (depth - radius)
                    left = math.floor(fx * (u - reach) + cx) - 1
                    right = math.ceil(fx * (u + reach) + cx) + 1
                    top = math.floor(fy * (v - reach) + cy) - 1
                    bottom = math.ceil(fy * (v + reach) + cy) + 1
                    # The object may continue beyond the border, so a view cannot judge a ball that its border cuts.
                    if left < 0 or top < 0 or right > length or bottom > height:
                        continue
                    cell = (i * cells + j) * cells + k
                    seen[cell] += 1
                    if sums[bottom, right] - sums[top, right] - sums[bottom, left] + sums[top, left] == 0:
                        clear[cell] += 1
