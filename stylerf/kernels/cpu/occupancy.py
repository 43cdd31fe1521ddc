"""Distances to occupied cells, used to skip empty space."""

import numpy as np

from stylerf.kernels.cpu.compiling import inline, serial_kernel

FARTHEST = 255  # cells; maximum of uint8


@inline
def _relax_row(out, x, y, toward, lowest):
    """Lower the distances of row out[x, y] to one more than those of its neighbors already visited in this pass.

    toward: 1 in the pass from low to high indices, -1 in the other. lowest: scratch memory for a row plus one cell at
    each end, which hold FARTHEST.
    """
    cells = out.shape[0]
    row = out[x, y]
    for z in range(cells):
        lowest[z + 1] = np.uint8(FARTHEST)
    for side in range(4):  # three rows of the plane before, one of this plane
        px, py = (x - toward, y + side - 1) if side < 3 else (x, y - toward)
        if 0 <= px < cells and 0 <= py < cells:
            other = out[px, py]
            for z in range(cells):
                lowest[z + 1] = min(lowest[z + 1], other[z])
    for z in range(cells):
        near = min(lowest[z], lowest[z + 1], lowest[z + 2])
        row[z] = min(row[z], np.uint8(near + np.uint8(near < FARTHEST)))
    last = np.int64(FARTHEST)
    for step in range(cells):
        z = step if toward > 0 else cells - 1 - step
        last = min(np.int64(row[z]), last + 1)
        row[z] = last


@serial_kernel
def chebyshev_distances(occupied, out):
    """out[i, j, k] = Chebyshev distance to the nearest occupied cell, at most FARTHEST (also if none is occupied).

    Two passes, each over half of a cell's 26 neighbors, are exact for this metric (Rosenfeld and Pfaltz 1968).

    Args:
        occupied: [s, s, s] bool.
        out: [s, s, s] uint8.
    """
    cells = out.shape[0]
    lowest = np.full(cells + 2, np.uint8(FARTHEST))
    for x in range(cells):
        for y in range(cells):
            for z in range(cells):
                out[x, y, z] = np.uint8(0) if occupied[x, y, z] else np.uint8(FARTHEST)
    for x in range(cells):
        for y in range(cells):
            _relax_row(out, x, y, 1, lowest)
    for x in range(cells - 1, -1, -1):
        for y in range(cells - 1, -1, -1):
            _relax_row(out, x, y, -1, lowest)
