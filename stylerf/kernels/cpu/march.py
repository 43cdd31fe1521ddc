"""march: what is common to every way of walking a ray through the occupied part of space.

Space is warped to the unit cube by one of three maps (stylerf/geometry/space.py holds them in words and in float64):
box (0), contraction (1), frustum (2). A step advances the warped position by `step` in the largest coordinate, so one
sample falls into each cell of the field wherever the ray is. The occupancy grid stores, per cell, 0 where occupied and
else the Chebyshev distance to the nearest occupied cell, in cells: an empty ray leaps over what cannot matter.
"""

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import inline, parallel_kernel

BOX, CONTRACTION, FRUSTUM = 0, 1, 2
OPTICAL_SCALE = np.float32(100.0)  # raw density 1 is an optical depth of 1 across a hundredth of the unit cube
_ONE, _ZERO, _HALF, _TWO = np.float32(1), np.float32(0), np.float32(0.5), np.float32(2)
_TINY = np.float32(1e-9)


@inline
def warp_at(kind, space, px, py, pz, dx, dy, dz, out):
    """Warped position out[0:3], the speed at which it moves along (dx, dy, dz), and the density jacobian.

    space: box: lo(3), 1/extent(3), mean 1/extent. contraction: centre(3), 1/half(3), mean 1/half.
    frustum: bx, by, near. Speed: largest |d out / dt|. Jacobian: cube units per scene unit towards infinity.
    """
    if kind == FRUSTUM:
        z = max(pz, space[2] * _HALF)
        i = _ONE / z
        out[0] = _HALF + _HALF * px * i / space[0]
        out[1] = _HALF + _HALF * py * i / space[1]
        out[2] = _ONE - space[2] * i
        jacobian = space[2] * i * i
        sx = abs(_HALF * (dx - px * i * dz) * i / space[0])
        sy = abs(_HALF * (dy - py * i * dz) * i / space[1])
        speed = max(sx, sy, abs(jacobian * dz))
    else:
        ax = (px - space[0]) * space[3]
        ay = (py - space[1]) * space[4]
        az = (pz - space[2]) * space[5]
        vx = dx * space[3]
        vy = dy * space[4]
        vz = dz * space[5]
        if kind == BOX:
            out[0] = ax
            out[1] = ay
            out[2] = az
            jacobian = space[6]
            speed = max(abs(vx), abs(vy), abs(vz))
        else:
            m = max(abs(ax), abs(ay), abs(az))
            jacobian = space[6] * np.float32(0.25)
            if m > _ONE:
                # x' = x (2 - 1/m)/m with m the largest coordinate; dm/dt is that coordinate's own velocity.
                i = _ONE / m
                s = (_TWO - i) * i
                if abs(ax) == m:
                    dm = vx if ax > _ZERO else -vx
                elif abs(ay) == m:
                    dm = vy if ay > _ZERO else -vy
                else:
                    dm = vz if az > _ZERO else -vz
                ds = _TWO * (i - _ONE) * i * i * dm
                vx = vx * s + ax * ds
                vy = vy * s + ay * ds
                vz = vz * s + az * ds
                ax *= s
                ay *= s
                az *= s
                jacobian *= i * i
            out[0] = _HALF + np.float32(0.25) * ax
            out[1] = _HALF + np.float32(0.25) * ay
            out[2] = _HALF + np.float32(0.25) * az
            speed = np.float32(0.25) * max(abs(vx), abs(vy), abs(vz))
    for a in range(3):
        out[a] = min(max(out[a], _ZERO), _ONE)
    return max(speed, _TINY), jacobian


@inline
def ray_span(kind, space, ox, oy, oz, dx, dy, dz, near, far):
    """Distances between which a ray is marched: the box's entry and exit, or near and far. Empty: first >= second."""
    t0, t1 = near, far
    if kind == BOX:
        for a in range(3):
            if a == 0:
                o, d = ox, dx
            elif a == 1:
                o, d = oy, dy
            else:
                o, d = oz, dz
            p = (o - space[a]) * space[3 + a]
            v = d * space[3 + a]
            if abs(v) < _TINY:
                if p < _ZERO or p > _ONE:
                    return _ONE, _ZERO
            else:
                i = _ONE / v
                u, w = -p * i, (_ONE - p) * i
                if u > w:
                    u, w = w, u
                t0 = max(t0, u)
                t1 = min(t1, w)
    return t0, t1


@inline
def leap(kind, space, ox, oy, oz, dx, dy, dz, t, dt, distance, cells, step, q, ahead):
    """Steps of dt that can be taken at once from q, whose nearest occupied cell is `distance` cells away.

    A box has one speed, and in a frustum rays only slow down. A contraction speeds up towards its middle, up to
    sixteenfold from m = 4: there the leap is halved until what is moved in the cube is within reach. A straight line's
    image strays from between its ends by a few hundredths of their distance at most, hence the margin.
    """
    if distance <= 1:
        return np.int64(1)
    reach = (np.float32(distance) - _ONE) / np.float32(cells)
    steps = max(np.int64(1), np.int64(reach / step))
    if kind == CONTRACTION:
        reach *= np.float32(0.95)
        while steps > 1:
            s = t + dt * np.float32(steps)
            warp_at(kind, space, ox + s * dx, oy + s * dy, oz + s * dz, dx, dy, dz, ahead)
            if max(abs(ahead[0] - q[0]), abs(ahead[1] - q[1]), abs(ahead[2] - q[2])) <= reach:
                break
            steps >>= 1
    return steps


@inline
def cell_distance(occupancy, cells, q):
    """Chebyshev distance, in cells, from the cell of warped point q to the nearest occupied one; 0: occupied."""
    i = min(int(q[0] * np.float32(cells)), cells - 1)
    j = min(int(q[1] * np.float32(cells)), cells - 1)
    k = min(int(q[2] * np.float32(cells)), cells - 1)
    return occupancy[(i * cells + j) * cells + k]


@parallel_kernel
def warp_points(kind, space, points, chunks, out, jacobians):
    """Warped position and density jacobian of free points [n, 3]."""
    n = len(points)
    for c in prange(chunks):
        q = np.empty(3, np.float32)
        for p in range(c * n // chunks, (c + 1) * n // chunks):
            _, jacobian = warp_at(kind, space, points[p, 0], points[p, 1], points[p, 2], _ONE, _ZERO, _ZERO, q)
            out[p, 0] = q[0]
            out[p, 1] = q[1]
            out[p, 2] = q[2]
            jacobians[p] = jacobian
