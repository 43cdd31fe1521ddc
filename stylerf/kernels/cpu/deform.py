"""Gradients of a deformation x' = x + D(x): from densities and colours to positions, from positions to a grid D.

The grid is flat [cells^3, 3] on the vertices of the cube, interpolated trilinearly, as march_density reads it.
"""

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import parallel_kernel
from stylerf.kernels.cpu.march import warp_at
from stylerf.kernels.cpu.vector import vm_slopes
from stylerf.kernels.cpu.vm import cell, place

_ONE, _ZERO = np.float32(1), np.float32(0)


@parallel_kernel
def density_position_gradient(table, size, ranks, x, starts, ends, sigma, sigma_gradients, chunks, position_gradients):
    """Add dL/dx [n, 3] of a vm density; the slope is that of the cell a sample lies in."""
    n = len(ends)
    for c in prange(chunks):
        slopes = np.empty(3, np.float32)
        for r in range(c * n // chunks, (c + 1) * n // chunks):
            for k in range(starts[r], ends[r]):
                g = sigma_gradients[k] * sigma[k]
                if g != _ZERO:
                    for m in range(3):
                        first, second, line, fu, fv, fw = place(m, x[k], size, np.int64(len(ranks)))
                        vm_slopes(table, first, second, line, fu, fv, fw, slopes, ranks)
                        for axis in range(3):
                            along = (m + 1 + axis) % 3
                            position_gradients[k, along] += g * slopes[axis] * np.float32(size[along] - 1)


@parallel_kernel
def displacement_backward(
    kind, space, origins, directions, t, optical, x, starts, ends, position_gradients, cells, chunks, to
):
    """Add dL/dD to the chunk's buffer to[chunk], flat [cells^3, 3], from dL/dx' [n, 3].

    x: the displaced positions x'. Where one was clamped to the cube's side it does not move with D. Samples of no
    optical length are the backdrop's, which is not displaced.
    """
    n = len(ends)
    for c in prange(chunks):
        q = np.empty(3, np.float32)
        for r in range(c * n // chunks, (c + 1) * n // chunks):
            ox, oy, oz = origins[r, 0], origins[r, 1], origins[r, 2]
            dx, dy, dz = directions[r, 0], directions[r, 1], directions[r, 2]
            for k in range(starts[r], ends[r]):
                if optical[k] == _ZERO:
                    continue
                s = t[k]
                warp_at(kind, space, ox + s * dx, oy + s * dy, oz + s * dz, dx, dy, dz, q)
                i, fx = cell(q[0], cells)
                j, fy = cell(q[1], cells)
                h, fz = cell(q[2], cells)
                at = (i * cells + j) * cells + h
                for corner in range(8):
                    di, dj, dh = corner >> 2, (corner >> 1) & 1, corner & 1
                    w = (fx if di else _ONE - fx) * (fy if dj else _ONE - fy) * (fz if dh else _ONE - fz)
                    for a in range(3):
                        if x[k, a] > _ZERO and x[k, a] < _ONE:
                            to[c, (at + (di * cells + dj) * cells + dh) * 3 + a] += w * position_gradients[k, a]
