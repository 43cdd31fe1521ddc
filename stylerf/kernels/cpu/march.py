"""march: rays through the occupied part of space to packed samples.

Space is warped to the unit cube by one of three maps (stylerf/geometry/space.py holds them in words and in float64):
box (0), contraction (1), frustum (2). A step advances the warped position by `step` in the largest coordinate, so one
sample falls into each cell of the field wherever the ray is. The occupancy grid stores, per cell, 0 where occupied and
else the Chebyshev distance to the nearest occupied cell, in cells: an empty ray leaps over what cannot matter.
"""

import math

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
        speed = max(max(sx, sy), abs(jacobian * dz))
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
            speed = max(max(abs(vx), abs(vy)), abs(vz))
        else:
            m = max(max(abs(ax), abs(ay)), abs(az))
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
            speed = np.float32(0.25) * max(max(abs(vx), abs(vy)), abs(vz))
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
def leap(distance, cells, step):
    """Steps that can be taken at once from a cell whose nearest occupied cell is `distance` cells away."""
    if distance > 1:
        # One step short of the border, since the warp's speed changes along the leap.
        return max(np.int64(1), np.int64((np.float32(distance) - _ONE) / (np.float32(cells) * step)))
    return np.int64(1)


@inline
def _march_ray(kind, space, o, d, jitter, near, far, step, occupancy, cells, limit, q, at, t_out, dt_out, x_out):
    """March one ray; write its samples from `at` on unless at < 0; return how many there are."""
    t, end = ray_span(kind, space, o[0], o[1], o[2], d[0], d[1], d[2], near, far)
    found = 0
    first = True
    guard = 0
    while t < end and found < limit and guard < 8192:
        guard += 1
        speed, jacobian = warp_at(
            kind, space, o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2], d[0], d[1], d[2], q
        )
        dt = step / speed
        if first:
            t += jitter * dt
            first = False
            continue
        i = min(int(q[0] * np.float32(cells)), cells - 1)
        j = min(int(q[1] * np.float32(cells)), cells - 1)
        k = min(int(q[2] * np.float32(cells)), cells - 1)
        distance = occupancy[(i * cells + j) * cells + k]
        if distance == 0:
            if at >= 0:
                t_out[at + found] = t
                dt_out[at + found] = dt * jacobian * OPTICAL_SCALE
                x_out[at + found, 0] = q[0]
                x_out[at + found, 1] = q[1]
                x_out[at + found, 2] = q[2]
            found += 1
            t += dt
        else:
            t += dt * np.float32(leap(distance, cells, step))
    return found


@parallel_kernel
def count_samples(kind, space, origins, directions, jitter, near, far, step, occupancy, cells, limit, chunks, counts):
    """counts[r] = samples of ray r in occupied cells, at most `limit`."""
    n = len(origins)
    for c in prange(chunks):
        q = np.empty(3, np.float32)
        unused = np.empty(0, np.float32)
        unused_x = np.empty((0, 3), np.float32)
        for r in range(c * n // chunks, (c + 1) * n // chunks):
            counts[r] = _march_ray(
                kind, space, origins[r], directions[r], jitter[r], near[r], far, step, occupancy, cells, limit, q, -1,
                unused, unused, unused_x,
            )


@parallel_kernel
def fill_samples(
    kind, space, origins, directions, jitter, near, far, step, occupancy, cells, limit, chunks, offsets, t, optical, x
):
    """Write the samples counted before: distance t, optical length of unit raw density, warped position x."""
    n = len(origins)
    for c in prange(chunks):
        q = np.empty(3, np.float32)
        for r in range(c * n // chunks, (c + 1) * n // chunks):
            _march_ray(
                kind, space, origins[r], directions[r], jitter[r], near[r], far, step, occupancy, cells, limit, q,
                offsets[r], t, optical, x,
            )


@parallel_kernel
def warp_points(kind, space, points, chunks, out, jacobians):
    """Warped position and density jacobian of free points [n, 3]."""
    n = len(points)
    for c in prange(chunks):
        q = np.empty(3, np.float32)
        for p in range(c * n // chunks, (c + 1) * n // chunks):
            _, jacobian = warp_at(
                kind, space, points[p, 0], points[p, 1], points[p, 2], _ONE, _ZERO, _ZERO, q
            )
            out[p, 0] = q[0]
            out[p, 1] = q[1]
            out[p, 2] = q[2]
            jacobians[p] = jacobian


@parallel_kernel
def optical_weights(sigma, optical, offsets, chunks, weights):
    """weights[k] = T_k (1 - exp(-sigma_k optical_k)), T the product of exp(-sigma optical) before k, per ray."""
    n = len(offsets) - 1
    for c in prange(chunks):
        for r in range(c * n // chunks, (c + 1) * n // chunks):
            through = _ONE
            for k in range(offsets[r], offsets[r + 1]):
                stay = np.float32(math.exp(-sigma[k] * optical[k]))
                weights[k] = through * (_ONE - stay)
                through *= stay
