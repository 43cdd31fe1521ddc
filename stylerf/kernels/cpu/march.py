"""Ray marching with empty-space skipping, for a density of any kind.

Space is warped to the unit cube by one of three maps (stylerf/geometry/space_warp.py has the formulas, in float64): box
(0), contraction (1), frustum (2). A step advances the warped position by `step` in its fastest coordinate, so that
samples are as dense as the field's cells everywhere along the ray. The occupancy grid stores, per cell, the Chebyshev
distance to the nearest occupied cell, in cells (0: occupied), which is used to skip empty space.

In a box, a frustum, and the inner box of a contraction, a ray is a straight line in the cube, where steps are additions
(line_at). Elsewhere in a contraction, every step evaluates the warp.
"""

import math

import numpy as np

from stylerf.kernels.cpu.compiling import inline

BOX, CONTRACTION, FRUSTUM = 0, 1, 2
# Raw density 1 is an optical depth of 1 across a hundredth of the unit cube (decision 0002). The GPU kernels and the
# torch reference use this constant; this folder's sources are part of the cache key, so changes recompile all kernels.
OPTICAL_SCALE = np.float32(100.0)
# Of raw density: exp(12) is opaque within any step, exp(-15) transparent across the cube; both fit in float32.
EXPONENT_MIN, EXPONENT_MAX = np.float32(-15), np.float32(12)
# Beyond this multiple of its width and height, and in front of half its near depth, a frustum consists only of its
# stretched outermost cells, so rays begin and end there.
FRUSTUM_MARGIN = np.float32(2.0)
_ONE, _ZERO, _HALF, _TWO, _QUARTER = np.float32(1), np.float32(0), np.float32(0.5), np.float32(2), np.float32(0.25)
LONGEST_LINE = np.float32(2.5)  # cube units: a frustum's depth from half its near plane, plus rounding
_PARTS = np.float32(256)
TINY = np.float32(1e-9)  # below any speed or slope that matters; keeps divisions finite


@inline
def clamped(x):
    return min(max(_ZERO, x), _ONE)  # in this order, NaN becomes 0, which is a valid cell index


@inline
def warp_at(space, px, py, pz, dx, dy, dz, out):
    """Warp a point into out[0:3]; return its speed along (dx, dy, dz) and the density Jacobian.

    Speed: largest |d out / dt|. Jacobian: cube units per scene unit, towards infinity. The parameters of each kind:

        box          low(3), 1/extent(3), mean 1/extent
        contraction  center(3), 1/half(3), mean 1/half
        frustum      bx, by, near
    """
    kind, numbers = space.kind, space.numbers
    if kind == FRUSTUM:
        z = max(pz, numbers[2] * _HALF)  # in front of the near plane, the map would go to infinity
        i = _ONE / z
        out[0] = _HALF + _HALF * px * i / numbers[0]
        out[1] = _HALF + _HALF * py * i / numbers[1]
        out[2] = _ONE - numbers[2] * i
        # d(1 - near/z)/dz: the scale along depth, independent of the ray's direction (decision 0002).
        jacobian = numbers[2] * i * i
        # Quotient rule: d(x/z)/dt = (dx - x/z dz)/z.
        sx = abs(_HALF * (dx - px * i * dz) * i / numbers[0])
        sy = abs(_HALF * (dy - py * i * dz) * i / numbers[1])
        speed = max(sx, sy, abs(jacobian * dz))
    else:
        ax = (px - numbers[0]) * numbers[3]
        ay = (py - numbers[1]) * numbers[4]
        az = (pz - numbers[2]) * numbers[5]
        vx = dx * numbers[3]
        vy = dy * numbers[4]
        vz = dz * numbers[5]
        if kind == BOX:
            out[0] = ax
            out[1] = ay
            out[2] = az
            jacobian = numbers[6]
            speed = max(abs(vx), abs(vy), abs(vz))
        else:
            m = max(abs(ax), abs(ay), abs(az))
            # Contracted space spans -2..2, so one unit is a quarter of the cube.
            jacobian = numbers[6] * _QUARTER
            if m > _ONE:
                # x' = x (2 - 1/m)/m with m the largest coordinate; dm/dt is that coordinate's velocity.
                i = _ONE / m
                s = (_TWO - i) * i
                if abs(ax) == m:
                    dm = vx if ax > _ZERO else -vx
                elif abs(ay) == m:
                    dm = vy if ay > _ZERO else -vy
                else:
                    dm = vz if az > _ZERO else -vz
                # s = 2/m - 1/m^2, hence ds/dm = 2 (1/m - 1)/m^2.
                ds = _TWO * (i - _ONE) * i * i * dm
                vx = vx * s + ax * ds
                vy = vy * s + ay * ds
                vz = vz * s + az * ds
                ax *= s
                ay *= s
                az *= s
                jacobian *= i * i  # d(2 - 1/m)/dm
            out[0] = _HALF + _QUARTER * ax
            out[1] = _HALF + _QUARTER * ay
            out[2] = _HALF + _QUARTER * az
            speed = _QUARTER * max(abs(vx), abs(vy), abs(vz))
    for a in range(3):
        out[a] = clamped(out[a])
    return max(TINY, speed), jacobian


@inline
def ray_span(space, ox, oy, oz, dx, dy, dz, near):
    """Return the range of distances to march: between entry and exit for a box or a frustum, within near and far.
    Empty if first >= second."""
    t0, t1, numbers = near, space.far, space.numbers
    if space.kind == BOX:
        for a in range(3):
            if a == 0:
                o, d = ox, dx
            elif a == 1:
                o, d = oy, dy
            else:
                o, d = oz, dz
            p = (o - numbers[a]) * numbers[3 + a]
            v = d * numbers[3 + a]
            # Parallel to these two faces: -p / v would be NaN on either of them.
            if abs(v) < TINY:
                if p < _ZERO or p > _ONE:
                    return _ONE, _ZERO
            else:
                i = _ONE / v
                u, w = -p * i, (_ONE - p) * i
                if u > w:
                    u, w = w, u
                t0 = max(t0, u)
                t1 = min(t1, w)
    elif space.kind == FRUSTUM:
        for side in range(5):  # p: height of the origin above each side's plane, v: its change along the ray
            if side == 0:
                p, v = oz - numbers[2] * _HALF, dz
            elif side <= 2:
                wide = FRUSTUM_MARGIN * numbers[0]
                p, v = (wide * oz - ox, wide * dz - dx) if side == 1 else (wide * oz + ox, wide * dz + dx)
            else:
                wide = FRUSTUM_MARGIN * numbers[1]
                p, v = (wide * oz - oy, wide * dz - dy) if side == 3 else (wide * oz + oy, wide * dz + dy)
            if v < TINY:
                if p < _ZERO:
                    return _ONE, _ZERO
                if v < -TINY:
                    t1 = min(t1, -p / v)
            elif p < _ZERO:
                t0 = max(t0, -p / v)
    return t0, t1


@inline
def line_at(space, ox, oy, oz, dx, dy, dz, t, end):
    """Return the ray from distance t to end as a line in the cube; in a contraction, until it leaves the inner box.

    A frustum is a projection, which maps lines to lines. Its speed and its Jacobian are both proportional to 1 / z^2,
    so all samples have the same optical length; distance grows as u / (speed - bend u).

    Returns:
        t; the line's start (3) and direction (3), with largest coordinate 1; speed at the start; bend; length (u at the
        end); density Jacobian at the start. u: cube units along the fastest coordinate.
    """
    kind, numbers = space.kind, space.numbers
    px, py, pz = ox + t * dx, oy + t * dy, oz + t * dz
    if kind == FRUSTUM:
        i = _ONE / pz  # ray_span ensures that pz is at least half the near depth
        jacobian, bend = numbers[2] * i * i, dz * i
        x, y, z = _HALF + _HALF * px * i / numbers[0], _HALF + _HALF * py * i / numbers[1], _ONE - numbers[2] * i
        vx, vy = _HALF * (dx - px * bend) * i / numbers[0], _HALF * (dy - py * bend) * i / numbers[1]
        vz = jacobian * dz
    else:
        x, y, z = (px - numbers[0]) * numbers[3], (py - numbers[1]) * numbers[4], (pz - numbers[2]) * numbers[5]
        vx, vy, vz = dx * numbers[3], dy * numbers[4], dz * numbers[5]
        jacobian, bend = numbers[6], _ZERO
        if kind == CONTRACTION:
            for p, v in ((x, vx), (y, vy), (z, vz)):
                end = min(end, t + (_ONE - p if v > _ZERO else _ONE + p) / max(TINY, abs(v)))
            x, y, z = _HALF + _QUARTER * x, _HALF + _QUARTER * y, _HALF + _QUARTER * z
            vx, vy, vz, jacobian = _QUARTER * vx, _QUARTER * vy, _QUARTER * vz, _QUARTER * jacobian
    speed = max(TINY, abs(vx), abs(vy), abs(vz))
    i = _ONE / speed
    # For a frustum's ray from very far away, the divisor may be rounded to zero.
    length = min(speed / max(_ONE / max(end - t, TINY) + bend, TINY), LONGEST_LINE)
    return t, x, y, z, vx * i, vy * i, vz * i, speed, bend, length, jacobian


@inline
def place_on(line, along, out):
    """out = position at `along` (u) on a line, clamped to the cube."""
    _, x, y, z, wx, wy, wz, _, _, _, _ = line
    out[0], out[1], out[2] = clamped(x + along * wx), clamped(y + along * wy), clamped(z + along * wz)


@inline
def distance_on(line, along):
    """Return the distance from the ray's origin, scene units, of position `along` (u) on a line."""
    t, _, _, _, _, _, _, speed, bend, _, _ = line
    return t + along / (speed - bend * along)


@inline
def skip_curved(space, ox, oy, oz, dx, dy, dz, t, dt, steps, reach, q, ahead):
    """Skip up to `steps` steps of dt from q along a curved image, moving at most `reach` cube units.

    Rays accelerate towards a contraction's center, up to sixteenfold from m = 4: the skip is halved until it stays
    within reach or is a single step. The image deviates from the segment between two of its points by at most a few
    hundredths of their distance, hence the margin of 0.95.

    Returns:
        Distance along the ray, speed and Jacobian at the position written to `ahead`.
    """
    while True:
        s = t + dt * np.float32(steps)
        speed, jacobian = warp_at(space, ox + s * dx, oy + s * dy, oz + s * dz, dx, dy, dz, ahead)
        moved = max(abs(ahead[0] - q[0]), abs(ahead[1] - q[1]), abs(ahead[2] - q[2]))
        if steps <= 1 or moved <= np.float32(0.95) * reach:
            return s, speed, jacobian
        steps >>= 1


@inline
def cell_distance(occupancy, cells, q):
    """Return the Chebyshev distance, in cells, from warped point q's cell to the nearest occupied one; 0: occupied."""
    # The far face, q = 1, belongs to the last cell.
    i = min(int(q[0] * np.float32(cells)), cells - 1)
    j = min(int(q[1] * np.float32(cells)), cells - 1)
    k = min(int(q[2] * np.float32(cells)), cells - 1)
    return occupancy[(i * cells + j) * cells + k]


@inline
def cell(x, size):
    """Return the cell index and the position in the cell of x in 0..1 on `size` vertices."""
    s = x * np.float32(size - 1)
    # x = 1 belongs to the last cell; even for a NaN, the index stays inside the table.
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
def end_of_partition(ends, thread, threads):
    """Return the end of a thread's samples (0: it has no rays).

    Samples of consecutive rays are contiguous up to there, so prefetching can cross rays.
    """
    last = (thread + 1) * len(ends) // threads
    return ends[last - 1] if last > 0 else np.int64(0)


@inline
def no_prefetch(density, shape, q):
    """Prefetch nothing: for densities whose lookups are too scattered to benefit."""


@inline
def march_partition(
    raw_density, prefetch, density, shape, rays, space, occupancy, displacement, settings, thread, threads, samples
):
    """March a thread's rays front to back until transmittance, range or sample limit is exhausted.

    Args:
        raw_density: inline function (density, shape, position) -> sigma. The kernels that call this are compiled around
            it, so no kind of density pays for the others.
        prefetch: inline function (density, shape, position) that prefetches what raw_density will read there.
        density: Density of that kind. shape: a tuple whose length raw_density needs at compile time.
        samples: output. Each thread packs its samples from first_ray * samples_per_ray on; the arrays have rays *
            samples_per_ray elements, of which only pages that are written take up memory.
    """
    origins, directions = rays.origins, rays.directions
    distances, cells = occupancy.distances, occupancy.cells
    step, samples_per_ray, min_transmittance = settings.step, settings.samples_per_ray, settings.min_transmittance
    starts, ends, t_out, deltas, x, sigma, weights = samples
    # Per ray: enter, skip empty cells and sample the others, then let the background absorb the remaining light.
    n = len(origins)
    q = np.empty(3, np.float32)
    ahead = np.empty(3, np.float32)
    moved = np.empty(3, np.float32)
    # In units of 1/256: an integer product, since it is on the critical path to the next cell.
    steps_per_cell = np.int64(_PARTS / (np.float32(cells) * step))
    # A fixed partition instead of prange's schedule, since sums must not depend on timing (decision 0007).
    begin = thread * n // threads
    at = begin * samples_per_ray
    for r in range(begin, (thread + 1) * n // threads):
        starts[r] = at
        ox, oy, oz = origins[r, 0], origins[r, 1], origins[r, 2]
        dx, dy, dz = directions[r, 0], directions[r, 1], directions[r, 2]
        t, end = ray_span(space, ox, oy, oz, dx, dy, dz, rays.near[r])
        transmittance = _ONE
        last = at + samples_per_ray
        line = line_at(space, ox, oy, oz, dx, dy, dz, t, end)
        along, length = _ZERO, line[-2]
        speed, jacobian = line[-4], line[-1]
        on_line = space.kind != CONTRACTION
        marching = t < end
        if marching and on_line:
            along = rays.jitter[r] * step
            place_on(line, along, q)
            marching = along < length
        elif marching:
            speed, _ = warp_at(space, ox + t * dx, oy + t * dy, oz + t * dz, dx, dy, dz, q)
            # Jitter is a fraction of a step in the cube; the speed there converts it to a distance.
            t += rays.jitter[r] * step / speed
            speed, jacobian = warp_at(space, ox + t * dx, oy + t * dy, oz + t * dz, dx, dy, dz, q)
            marching = t < end
        while marching and transmittance >= min_transmittance and at < last:
            distance = cell_distance(distances, cells, q)
            # At least distance - 1 complete cells are between q and the nearest occupied one.
            steps = max(np.int64(1), (np.int64(distance) - 1) * steps_per_cell >> 8)
            # The next position does not depend on this sample's density: compute it first, so that its rows can be
            # prefetched while this density is evaluated.
            dt = step / speed
            here, next_along, next_speed, next_jacobian = t, along, speed, jacobian
            if on_line:
                if distance == 0:
                    here = distance_on(line, along)
                next_along = along + np.float32(steps) * step
                place_on(line, next_along, ahead)
            else:
                reach = (np.float32(distance) - _ONE) / np.float32(cells)
                t, next_speed, next_jacobian = skip_curved(space, ox, oy, oz, dx, dy, dz, t, dt, steps, reach, q, ahead)
            if distance == 0:
                t_out[at] = here
                if displacement.vertices > 0:
                    displace(displacement.grid, displacement.vertices, q, moved)
                    q[0], q[1], q[2] = moved[0], moved[1], moved[2]
                else:
                    # Only without a displacement, which would read rows other than those around `ahead`.
                    prefetch(density, shape, ahead)
                raw = raw_density(density, shape, q)
                delta = dt * jacobian * OPTICAL_SCALE
                transmitted = np.float32(math.exp(-raw * delta))
                deltas[at] = delta
                x[at, 0], x[at, 1], x[at, 2] = q[0], q[1], q[2]
                sigma[at] = raw
                weights[at] = transmittance * (_ONE - transmitted)
                transmittance *= transmitted
                at += 1
            q[0], q[1], q[2] = ahead[0], ahead[1], ahead[2]
            # A step that is rounded away in float32 would loop forever.
            if on_line:
                marching = next_along > along and next_along < length
                along = next_along
                if not marching and space.kind == CONTRACTION:
                    on_line = False
                    t = distance_on(line, along)
                    marching = t < end
                    speed, jacobian = warp_at(space, ox + t * dx, oy + t * dy, oz + t * dz, dx, dy, dz, q)
            else:
                marching = t > here and t < end
                speed, jacobian = next_speed, next_jacobian
                if max(abs(q[0] - _HALF), abs(q[1] - _HALF), abs(q[2] - _HALF)) < _QUARTER:
                    line = line_at(space, ox, oy, oz, dx, dy, dz, t, end)
                    length = line[-2]
                    if length > step:  # a shorter one would end before the first step
                        on_line, along, speed, jacobian = True, _ZERO, line[-4], line[-1]
        if settings.opaque_background and transmittance >= min_transmittance and at < last:
            # The far end absorbs the remaining light (decision 0004). Its density is fixed; only its color learns.
            warp_at(space, ox + end * dx, oy + end * dy, oz + end * dz, dx, dy, dz, q)
            t_out[at] = end
            deltas[at] = _ZERO  # marks the background and makes its density's gradient zero
            x[at, 0], x[at, 1], x[at, 2] = q[0], q[1], q[2]
            sigma[at] = _ZERO
            weights[at] = transmittance
            at += 1
        ends[r] = at
