"""Gradients of a deformation x' = x + D(x): from densities and colors to positions, from positions to a grid D.

The grid is flat [cells^3, 3] on the vertices of the cube, interpolated trilinearly, as march_density reads it.
"""

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import parallel_kernel, serial_kernel
from stylerf.kernels.cpu.march import cell, cell_distance, displace, warp_at
from stylerf.kernels.cpu.simd_vm import axpy_row, vm_features_slopes, vm_slopes
from stylerf.kernels.cpu.vm import head_of_ray, place

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
def color_position_gradient(
    table, size, ranks, head, basis, x, starts, ends, colors, color_gradients, chunks, position_gradients
):
    """Add dL/dx [n, 3] of vm colors; head, basis, colors as in vm.color. A sample without a color adds nothing."""
    n = len(ends)
    rank, bands = np.int64(len(ranks)), basis.shape[1]
    width = 3 * rank
    for c in prange(chunks):
        ray_head, gradient = np.empty(3 * width, np.float32), np.empty(width, np.float32)
        slopes = np.empty(3, np.float32)
        for r in range(c * n // chunks, (c + 1) * n // chunks):
            ready = False
            for k in range(starts[r], ends[r]):
                if colors[k, 0] < _ZERO:
                    continue
                if not ready:
                    head_of_ray(head, basis, r, bands, width, ray_head)
                    ready = True
                gradient[:] = _ZERO
                for j in range(3):
                    g = color_gradients[k, j] * colors[k, j] * (_ONE - colors[k, j])
                    for m in range(3):
                        axpy_row(g, ray_head, j * width + m * rank, gradient, m * rank, ranks)
                for m in range(3):
                    first, second, line, fu, fv, fw = place(m, x[k], size, rank)
                    vm_features_slopes(table, first, second, line, fu, fv, fw, gradient, m * rank, slopes, ranks)
                    for axis in range(3):
                        along = (m + 1 + axis) % 3
                        position_gradients[k, along] += slopes[axis] * np.float32(size[along] - 1)


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


@parallel_kernel
def displaced_cells(distances, cells, reach, displacement, displacement_cells, occupied):
    """occupied[cell]: whether D takes any of 27 points of a cell, out to its sides, into a cell of distance 0.

    distances: as Occupancy's, flat [cells^3]. Cells farther than `reach` from what is occupied are not looked at.
    """
    for i in prange(cells):
        p, q = np.empty(3, np.float32), np.empty(3, np.float32)
        for j in range(cells):
            for k in range(cells):
                at = (i * cells + j) * cells + k
                if distances[at] > reach:
                    continue
                for point in range(27):
                    p[0] = (np.float32(i) + np.float32(0.02) + np.float32(0.48) * np.float32(point // 9)) / cells
                    p[1] = (np.float32(j) + np.float32(0.02) + np.float32(0.48) * np.float32(point // 3 % 3)) / cells
                    p[2] = (np.float32(k) + np.float32(0.02) + np.float32(0.48) * np.float32(point % 3)) / cells
                    displace(displacement, displacement_cells, p, q)
                    if cell_distance(distances, cells, q) == 0:
                        occupied[at] = True
                        break


@serial_kernel
def mark_cells(shown, x, starts, ends, vertices, seen):
    """seen [vertices, vertices, vertices]: the lower vertex of each grid cell that holds a sample with shown > 0."""
    for r in range(len(ends)):
        for k in range(starts[r], ends[r]):
            if shown[k] > _ZERO:
                i, _ = cell(x[k, 0], vertices)
                j, _ = cell(x[k, 1], vertices)
                h, _ = cell(x[k, 2], vertices)
                seen[i, j, h] = True
