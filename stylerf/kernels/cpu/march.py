"""Ray marching through the occupied part of space, for a density of any kind.

Space is warped to the unit cube by one of three maps (stylerf/geometry/space_warp.py has the formulas, in float64): box
(0), contraction (1), frustum (2). A step advances the warped position by `step` in its fastest coordinate, so that
samples are as dense as the field's cells anywhere along the ray. The occupancy grid stores, per cell, the Chebyshev
distance to the nearest occupied cell, in cells (0: occupied); rays skip empty space by it.

A ray is a line in the cube of a box or a frustum, and within the inner box of a contraction: there, steps are additions
(line_at). Elsewhere in a contraction every step evaluates the warp.
"""

import math

import numpy as np

from stylerf.kernels.cpu.compiling import inline

BOX, CONTRACTION, FRUSTUM = 0, 1, 2
# Raw density 1 is an optical depth of 1 across a hundredth of the unit cube (decision 0002). The GPU's kernels and the
# torch reference read it from here; this folder's sources name the cache, so that a change recompiles every kernel.
OPTICAL_SCALE = np.float32(100.0)
# Of raw density: exp(12) is opaque within any step, exp(-15) transparent across the cube, and float32 holds both.
EXPONENT_MIN, EXPONENT_MAX = np.float32(-15), np.float32(12)
# Beyond so many times its width and height, and in front of half its near depth, a frustum is nothing but its outermost
# cells, drawn out: rays begin and end there.
FRUSTUM_MARGIN = np.float32(2.0)
_ONE, _ZERO, _HALF, _TWO, _QUARTER = np.float32(1), np.float32(0), np.float32(0.5), np.float32(2), np.float32(0.25)
LONGEST_LINE = np.float32(2.5)  # cube units: a frustum's depth from half its near plane on, and rounding
_PARTS = np.float32(256)
TINY = np.float32(1e-9)  # below any speed or slope that matters; keeps divisions finite


@inline
def clamped(x):
    return min(max(_ZERO, x), _ONE)  # in this order NaN becomes 0, a valid index of a cell


@inline
def warp_at(space, px, py, pz, dx, dy, dz, out):
    """Warp a point into out[0:3]; return its speed along (dx, dy, dz) and the density jacobian.

    Speed: largest |d out / dt|. Jacobian: cube units per scene unit, towards infinity. The numbers of each kind:

        box          low(3), 1/extent(3), mean 1/extent
        contraction  center(3), 1/half(3), mean 1/half
        frustum      bx, by, near
    """
    kind, numbers = space.kind, space.numbers
    if kind == FRUSTUM:
        z = max(pz, numbers[2] * _HALF)  # behind the near plane the map would run away to infinity
        i = _ONE / z
        out[0] = _HALF + _HALF * px * i / numbers[0]
        out[1] = _HALF + _HALF * py * i / numbers[1]
        out[2] = _ONE - numbers[2] * i
        # d(1 - near/z)/dz: the scale along depth, whatever the ray's direction (decision 0002).
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
            # Contracted space spans -2..2, so that a unit of it is a quarter of the cube.
            jacobian = numbers[6] * _QUARTER
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
    """Distances between which a ray is marched: those of entry and exit in a box or a frustum, within near and far.
    Empty: first >= second."""
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
            # Parallel to these two faces: -p / v would be NaN on one of them.
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
        for side in range(5):  # of the plane through each, p is the height of the origin, v its change along the ray
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
    """The ray from distance t to end as a line in the cube; in a contraction, to where it leaves the inner box.

    A frustum is a projection, which maps lines to lines. Its speed and its jacobian both fall with 1 / z^2, so that all
    samples have the same optical length; distance grows with u / (speed - bend u).

    Returns:
        t; where the line begins (3) and its direction (3), of largest coordinate 1; speed there; bend; length (u at its
        end); density jacobian there. u counts cube units along the fastest coordinate.
    """
    kind, numbers = space.kind, space.numbers
    px, py, pz = ox + t * dx, oy + t * dy, oz + t * dz
    if kind == FRUSTUM:
        i = _ONE / pz  # ray_span leaves pz half the near depth at least
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
    # Rounding may leave nothing of the divisor where a frustum's ray comes from very far.
    length = min(speed / max(_ONE / max(end - t, TINY) + bend, TINY), LONGEST_LINE)
    return t, x, y, z, vx * i, vy * i, vz * i, speed, bend, length, jacobian


@inline
def place_on(line, along, out):
    """out = the position `along` (u) a line, clamped to the cube."""
    _, x, y, z, wx, wy, wz, _, _, _, _ = line
    out[0], out[1], out[2] = clamped(x + along * wx), clamped(y + along * wy), clamped(z + along * wz)


@inline
def distance_on(line, along):
    """Distance from the ray's origin of the position `along` (u) a line, scene units."""
    t, _, _, _, _, _, _, speed, bend, _, _ = line
    return t + along / (speed - bend * along)


@inline
def skip_curved(space, ox, oy, oz, dx, dy, dz, t, dt, steps, reach, q, ahead):
    """Take up to `steps` steps of dt from q, as many as move at most `reach` cube units, along a curved image.

    Rays speed up towards a contraction's middle, up to sixteenfold from m = 4: the skip is halved until it stays within
    reach, or is a single step. The image strays from the segment between two of its points by a few hundredths of their
    distance at most, hence the margin of 0.95.

    Returns:
        Distance along the ray, speed and jacobian of the position that goes to `ahead`.
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
    """Chebyshev distance, in cells, from the cell of warped point q to the nearest occupied one; 0: occupied."""
    # The far face, q = 1, belongs to the last cell.
    i = min(int(q[0] * np.float32(cells)), cells - 1)
    j = min(int(q[1] * np.float32(cells)), cells - 1)
    k = min(int(q[2] * np.float32(cells)), cells - 1)
    return occupancy[(i * cells + j) * cells + k]


@inline
def cell(x, size):
    """Lower cell index and position inside the cell of x in 0..1 on `size` vertices."""
    s = x * np.float32(size - 1)
    # x = 1 belongs to the last cell; a NaN's index stays inside the table.
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
    """Return where the samples of a thread's rays end (0: it has no rays).

    Samples of consecutive rays are contiguous up to there, so the next one can be prefetched across rays.
    """
    last = (thread + 1) * len(ends) // threads
    return ends[last - 1] if last > 0 else np.int64(0)


@inline
def no_prefetch(density, shape, q):
    """Prefetch nothing: for densities whose lookups are too scattered to gain by it."""


@inline
def march_partition(
    raw_density, prefetch, density, shape, rays, space, occupancy, displacement, settings, thread, threads, samples
):
    """March a thread's rays front to back until transmittance, span or sample limit is exhausted.

    Args:
        raw_density: inline function (density, shape, position) -> sigma. The kernels that call this are compiled around
            it, so that no kind of density pays for the others.
        prefetch: inline function (density, shape, position) that requests what raw_density will read there.
        density: Density of that kind. shape: a tuple whose length raw_density needs at compile time.
        samples: written. Each thread packs its samples from first_ray * samples_per_ray on; the arrays have rays *
            samples_per_ray elements, of which the operating system provides only the pages that are written.
    """
    origins, directions = rays.origins, rays.directions
    distances, cells = occupancy.distances, occupancy.cells
    step, samples_per_ray, min_transmittance = settings.step, settings.samples_per_ray, settings.min_transmittance
    starts, ends, t_out, deltas, x, sigma, weights = samples
    # Per ray: enter, skip empty cells and sample the others, then let the background take what light is left.
    n = len(origins)
    q = np.empty(3, np.float32)
    ahead = np.empty(3, np.float32)
    moved = np.empty(3, np.float32)
    # In 1/256: a product of integers, since the next cell to look at waits for it.
    steps_per_cell = np.int64(_PARTS / (np.float32(cells) * step))
    # A fixed partition instead of prange's schedule: sums must not depend on timing (decision 0007).
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
            # Jitter is a part of a step in the cube; the speed there turns it into a distance.
            t += rays.jitter[r] * step / speed
            speed, jacobian = warp_at(space, ox + t * dx, oy + t * dy, oz + t * dz, dx, dy, dz, q)
            marching = t < end
        while marching and transmittance >= min_transmittance and at < last:
            distance = cell_distance(distances, cells, q)
            # At least distance - 1 whole cells separate q from the nearest occupied one.
            steps = max(np.int64(1), (np.int64(distance) - 1) * steps_per_cell >> 8)
            # The next position does not depend on this sample's density: find it first, so that its rows can be
            # prefetched while this density is computed.
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
                    # Only without a displacement, which would read other rows than those around `ahead`.
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
            # A step that float32 rounds away would never end.
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
                    if length > step:  # a shorter one would end before its first step
                        on_line, along, speed, jacobian = True, _ZERO, line[-4], line[-1]
        if settings.opaque_background and transmittance >= min_transmittance and at < last:
            # The far end absorbs the remaining light (decision 0004). Its density is fixed: only its color learns.
            warp_at(space, ox + end * dx, oy + end * dy, oz + end * dz, dx, dy, dz, q)
            t_out[at] = end
            deltas[at] = _ZERO  # marks the background, and makes its density's gradient zero
            x[at, 0], x[at, 1], x[at, 2] = q[0], q[1], q[2]
            sigma[at] = _ZERO
            weights[at] = transmittance
            at += 1
        ends[r] = at
