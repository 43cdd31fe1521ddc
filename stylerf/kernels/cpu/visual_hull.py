"""Visual hull: which cells of a box a view sees, and in which of them it sees only background."""

import math

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import parallel_kernel


@parallel_kernel
def count_clear(sums, pose, fx, fy, cx, cy, low, width, cells, radius, threads, seen, clear):
    """Add 1 to seen[cell] if a cell's ball projects into the picture, to clear[cell] if nothing is marked there.

    Args:
        sums: [h + 1, w + 1] int32, summed-area table of the picture's marks.
        pose: [3, 4] float32, world from camera.
        low, width: [3] float32, the box's lower corner and its cells' sides.
        radius: of a cell's ball.
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
                    if depth <= radius:
                        continue
                    u = (x * pose[0, 0] + y * pose[1, 0] + z * pose[2, 0]) / depth
                    v = (x * pose[0, 1] + y * pose[1, 1] + z * pose[2, 1]) / depth
                    # A ball projects to an ellipse, longer the farther it is from the optical axis; this bounds it.
                    reach = radius * (np.float32(1) + u * u + v * v) / (depth - radius)
                    left = math.floor(fx * (u - reach) + cx) - 1
                    right = math.ceil(fx * (u + reach) + cx) + 1
                    top = math.floor(fy * (v - reach) + cy) - 1
                    bottom = math.ceil(fy * (v + reach) + cy) + 1
                    if left < 0 or top < 0 or right > length or bottom > height:
                        continue
                    cell = (i * cells + j) * cells + k
                    seen[cell] += 1
                    if sums[bottom, right] - sums[top, right] - sums[bottom, left] + sums[top, left] == 0:
                        clear[cell] += 1
