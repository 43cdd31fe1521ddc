"""march: what is common to every way of walking a ray through the occupied part of space.

Space is warped to the unit cube by one of three maps (stylerf/geometry/space_warp.py holds them in words and in
float64): box (0), contraction (1), frustum (2). A step advances the warped position by `step` in the largest
coordinate, so one sample falls into each cell of the field wherever the ray is. The occupancy grid stores, per cell, 0
where occupied and else the Chebyshev distance to the nearest occupied cell, in cells: an empty ray leaps over what
cannot matter.
"""

import math

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import inline, parallel_kernel

BOX, CONTRACTION, FRUSTUM = 0, 1, 2
OPTICAL_SCALE = np.float32(100.0)  # raw density 1 is an optical depth of 1 across a hundredth of the unit cube
EXPONENT_MIN, EXPONENT_MAX = np.float32(-15), np.float32(12)  # of raw density
_ONE, _ZERO, _HALF, _TWO = np.float32(1), np.float32(0), np.float32(0.5), np.float32(2)
_TINY = np.float32(1e-9)


@inline
def warp_at(kind, space, px, py, pz, dx, dy, dz, out):
    """Warped position out[0:3], the speed at which it moves along (dx, dy, dz), and the density jacobian.

    space: box: lo(3), 1/extent(3), mean 1/extent. contraction: center(3), 1/half(3), mean 1/half.
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
        out[a] = min(max(_ZERO, out[a]), _ONE)  # in this order NaN becomes 0: cells are looked up by it
    return max(_TINY, speed), jacobian


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
def _time_out_of(x, speed, distance, cells, least):
    """The less of `least` and the time until coordinate x has left all cells nearer than `distance` to its own."""
    if speed == _ZERO:
        return least
    own = np.float32(min(int(x * np.float32(cells)), cells - 1))
    edge = own + np.float32(distance) if speed > _ZERO else own - np.float32(distance) + _ONE
    time = (edge / np.float32(cells) - x) / speed
    return min(max(time, _ZERO), least)


@inline
def leap(kind, space, ox, oy, oz, dx, dy, dz, t, dt, distance, cells, step, q, ahead):
    """Steps of dt that can be taken at once from q, whose nearest occupied cell is `distance` cells away.

    In a box a ray goes straight on and leaps to the first step behind all cells that are known to be empty. In a
    frustum rays only slow down. A contraction speeds up towards its middle, up to sixteenfold from m = 4: there the
    leap is halved until what is moved in the cube is within reach. A straight line's image strays from between its ends
    by a few hundredths of their distance at most, hence the margin.
    """
    if kind == BOX:
        left = dt * _TWO / step  # twice the cube: no ray stays in it for longer
        left = _time_out_of(q[0], dx * space[3], distance, cells, left)
        left = _time_out_of(q[1], dy * space[4], distance, cells, left)
        left = _time_out_of(q[2], dz * space[5], distance, cells, left)
        return np.int64(left / dt) + 1
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


@inline
def cell(x, size):
    """Lower cell index and position inside the cell of x in 0..1 on `size` vertices."""
    s = x * np.float32(size - 1)
    i = min(max(np.int64(s), np.int64(0)), np.int64(size - 2))
    return i, s - np.float32(i)


@inline
def displace(displacement, cells, q, out):
    """out = q + trilinear(displacement, q), clamped to the cube; displacement: flat [cells^3, 3] on vertices."""
    i, fx = cell(q[0], cells)
    j, fy = cell(q[1], cells)
    k, fz = cell(q[2], cells)
    at = (i * cells + j) * cells + k
    for a in range(3):
        moved = q[a]
        for corner in range(8):
            di, dj, dk = corner >> 2, (corner >> 1) & 1, corner & 1
            w = (fx if di else _ONE - fx) * (fy if dj else _ONE - fy) * (fz if dk else _ONE - fz)
            moved += w * displacement[(at + (di * cells + dj) * cells + dk) * 3 + a]
        out[a] = min(max(_ZERO, moved), _ONE)


@inline
def end_of_chunk(ends, c, chunks):
    """Where the samples of chunk c end: ray after ray, they lie side by side up to there (0: the chunk has no rays).

    What the next sample will read can be asked for while one is worked on, also where it lies on the next ray.
    """
    last = (c + 1) * len(ends) // chunks
    return ends[last - 1] if last > 0 else np.int64(0)


@inline
def fetch_nothing(table, layout, shift, shape, q):
    """For kinds of fields that do not say what they will read."""


@inline
def walk_chunk(
    raw_density,
    fetch,
    table,
    layout,
    shift,
    shape,
    kind,
    space,
    origins,
    directions,
    jitter,
    near,
    far,
    step,
    occupancy,
    cells,
    limit,
    displacement,
    displacement_cells,
    opaque,
    closed,
    c,
    chunks,
    starts,
    ends,
    t_out,
    optical,
    x,
    sigma,
    weights,
):
    """Walk each ray of chunk c front to back until transmittance is under `opaque`, its span ends or `limit` samples

    lie on it. raw_density(table, layout, shift, shape, q): an inline function, one kind of field; the kernels that call
    this are compiled around it, so that no kind pays for the others. fetch: inline too, asks for what raw_density will
    read at a place, while the sample before it is worked on.

    Ray r's samples are starts[r]:ends[r] of t_out, optical (optical length of unit raw density), x (position in the
    cube, displaced), sigma (raw density) and weights (T (1 - exp(-sigma optical))). Each chunk of rays packs its
    samples from first_ray * limit on; the arrays have rays * limit elements, of which only those touched cost memory.
    closed: space ends in an opaque backdrop (captures of the real world), so that weights sum to one.
    """
    n = len(origins)
    q = np.empty(3, np.float32)
    ahead = np.empty(3, np.float32)
    moved = np.empty(3, np.float32)
    begin = c * n // chunks
    at = begin * limit
    for r in range(begin, (c + 1) * n // chunks):
        starts[r] = at
        ox, oy, oz = origins[r, 0], origins[r, 1], origins[r, 2]
        dx, dy, dz = directions[r, 0], directions[r, 1], directions[r, 2]
        t, end = ray_span(kind, space, ox, oy, oz, dx, dy, dz, near[r], far)
        through = _ONE
        last = at + limit
        if t < end:
            speed, _ = warp_at(kind, space, ox + t * dx, oy + t * dy, oz + t * dz, dx, dy, dz, q)
            t += jitter[r] * step / speed
            speed, jacobian = warp_at(kind, space, ox + t * dx, oy + t * dy, oz + t * dz, dx, dy, dz, q)
        while t < end and through >= opaque and at < last:
            dt = step / speed
            distance = cell_distance(occupancy, cells, q)
            if distance > 0:
                taken = leap(kind, space, ox, oy, oz, dx, dy, dz, t, dt, distance, cells, step, q, moved)
                s = t + dt * np.float32(taken)
                if not s > t:  # a step is lost in the rounding of so large a distance
                    break
                t = s
                speed, jacobian = warp_at(kind, space, ox + t * dx, oy + t * dy, oz + t * dz, dx, dy, dz, q)
                continue
            # Where the next sample will be is known before this one's density is.
            s = t + dt
            next_speed, next_jacobian = warp_at(kind, space, ox + s * dx, oy + s * dy, oz + s * dz, dx, dy, dz, ahead)
            t_out[at] = t
            if displacement_cells > 0:
                displace(displacement, displacement_cells, q, moved)
                q[0], q[1], q[2] = moved[0], moved[1], moved[2]
            else:
                fetch(table, layout, shift, shape, ahead)
            density = raw_density(table, layout, shift, shape, q)
            length = dt * jacobian * OPTICAL_SCALE
            stay = np.float32(math.exp(-density * length))
            optical[at] = length
            x[at, 0], x[at, 1], x[at, 2] = q[0], q[1], q[2]
            sigma[at] = density
            weights[at] = through * (_ONE - stay)
            through *= stay
            at += 1
            t, speed, jacobian = s, next_speed, next_jacobian
            q[0], q[1], q[2] = ahead[0], ahead[1], ahead[2]
        if closed and through >= opaque and at < last:
            # The far end takes what light is left; its density is fixed, so only its color learns.
            warp_at(kind, space, ox + end * dx, oy + end * dy, oz + end * dz, dx, dy, dz, q)
            t_out[at] = end
            optical[at] = _ZERO
            x[at, 0], x[at, 1], x[at, 2] = q[0], q[1], q[2]
            sigma[at] = _ZERO
            weights[at] = through
            at += 1
        ends[r] = at


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
