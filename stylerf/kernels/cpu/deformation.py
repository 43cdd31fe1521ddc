"""Gradients of a deformation x' = x + D(x) with respect to its grid D, and which cells it maps to occupied ones.

The grid is flat [cells^3, 3] on the vertices of the cube, interpolated trilinearly, as in march_density.
"""

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import parallel_kernel, serial_kernel
from stylerf.kernels.cpu.march import cell, cell_distance, displace, warp_at

_ONE, _ZERO = np.float32(1), np.float32(0)


@parallel_kernel
def displacement_backward(space, rays, samples, position_gradients, vertices, to):
    """Add dL/dD to the thread's buffer to[thread], flat [vertices^3, 3], from dL/dx' [n, 3].

    samples.x holds the displaced positions x'; coordinates clamped to the cube get no gradient. The opaque background
    (delta 0) is not displaced.
    """
    origins, directions = rays.origins, rays.directions
    starts, ends, t, deltas, x = samples.starts, samples.ends, samples.t, samples.deltas, samples.x
    n, threads = len(ends), len(to)
    for thread in prange(threads):
        q = np.empty(3, np.float32)
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            ox, oy, oz = origins[r, 0], origins[r, 1], origins[r, 2]
            dx, dy, dz = directions[r, 0], directions[r, 1], directions[r, 2]
            for k in range(starts[r], ends[r]):
                if deltas[k] == _ZERO:
                    continue
                s = t[k]
                # Samples hold only x'; x, where D was read, is recomputed from t.
                warp_at(space, ox + s * dx, oy + s * dy, oz + s * dz, dx, dy, dz, q)
                i, fx = cell(q[0], vertices)
                j, fy = cell(q[1], vertices)
                h, fz = cell(q[2], vertices)
                at = (i * vertices + j) * vertices + h
                for corner in range(8):
                    di, dj, dh = corner >> 2, (corner >> 1) & 1, corner & 1
                    w = (fx if di else _ONE - fx) * (fy if dj else _ONE - fy) * (fz if dh else _ONE - fz)
                    for a in range(3):
                        if x[k, a] > _ZERO and x[k, a] < _ONE:
                            to[thread, (at + (di * vertices + dj) * vertices + dh) * 3 + a] += (
                                w * position_gradients[k, a]
                            )


@parallel_kernel
def displaced_cells(occupancy, displacement, reach, occupied):
    """Set occupied[cell] where D maps any of 27 points in the cell into an occupied one.

    reach: upper bound of D in cells; cells farther than that from an occupied one are skipped.
    """
    distances, cells = occupancy
    grid, vertices = displacement
    for i in prange(cells):
        p, q = np.empty(3, np.float32), np.empty(3, np.float32)
        for j in range(cells):
            for k in range(cells):
                at = (i * cells + j) * cells + k
                if distances[at] > reach:
                    continue
                for point in range(27):  # a lattice 2 % inside the cell, to be safe from rounding
                    p[0] = (np.float32(i) + np.float32(0.02) + np.float32(0.48) * np.float32(point // 9)) / cells
                    p[1] = (np.float32(j) + np.float32(0.02) + np.float32(0.48) * np.float32(point // 3 % 3)) / cells
                    p[2] = (np.float32(k) + np.float32(0.02) + np.float32(0.48) * np.float32(point % 3)) / cells
                    displace(grid, vertices, p, q)
                    if cell_distance(distances, cells, q) == 0:
                        occupied[at] = True
                        break


@serial_kernel
def mark_cells(points, vertices, seen):
    """Set seen [v, v, v] at the lower vertex of each cell that contains a point with positive weight; v = vertices."""
    starts, ends, x, weights = points
    for r in range(len(ends)):
        for k in range(starts[r], ends[r]):
            if weights[k] > _ZERO:
                i, _ = cell(x[k, 0], vertices)
                j, _ = cell(x[k, 1], vertices)
                h, _ = cell(x[k, 2], vertices)
                seen[i, j, h] = True
