"""The warp of free points, as the march warps those on its rays."""

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import parallel_kernel
from stylerf.kernels.cpu.march import warp_at

_ONE, _ZERO = np.float32(1), np.float32(0)


@parallel_kernel
def warp_points(space, points, threads, out, jacobians):
    """Warp free points [n, 3] to the cube: positions to out [n, 3], density jacobians to jacobians [n]."""
    n = len(points)
    for thread in prange(threads):
        q = np.empty(3, np.float32)
        for p in range(thread * n // threads, (thread + 1) * n // threads):
            _, jacobian = warp_at(space, points[p, 0], points[p, 1], points[p, 2], _ONE, _ZERO, _ZERO, q)
            out[p, 0] = q[0]
            out[p, 1] = q[1]
            out[p, 2] = q[2]
            jacobians[p] = jacobian
