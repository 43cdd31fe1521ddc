"""Ray marching through warped space with empty-space skipping, to packed samples with density and weights.

One lane per ray, BLOCK rays per program, two launches of one kernel: the first counts samples, and the second, after a
cumulative sum of the counts, writes them. Rays whose samples would not fit get none. The capacity is fixed before the
launch, so the number of samples need not be read back.
"""

import triton
import triton.language as tl

from stylerf.kernels.cpu import march as cpu_march
from stylerf.kernels.gpu.indexing import SIZES, cell, store_vector, trilinear_corner, vector
from stylerf.kernels.gpu.tables import raw_density

SCALE, SMALLEST = tl.constexpr(float(cpu_march.OPTICAL_SCALE)), tl.constexpr(float(cpu_march.TINY))
FRUSTUM_MARGIN = tl.constexpr(float(cpu_march.FRUSTUM_MARGIN))
BEYOND = tl.constexpr(1e30)  # of any ray's end; finite, since what is masked out is still multiplied by zero
MOST_TURNS = tl.constexpr(1 << 16)  # a step too small for float32 to move the ray must not hang the GPU


@triton.jit
def clamped(x):
    return tl.minimum(tl.maximum(x, 0.0), 1.0)


@triton.jit
def warp_at(KIND: tl.constexpr, space, px, py, pz, dx, dy, dz):
    """(x, y, z in the cube, speed along (dx, dy, dz), density Jacobian); see warp_at on the CPU.

    KIND: 0 box, 1 contraction, 2 frustum. space: its seven parameters.
    """
    s0, s1, s2 = tl.load(space), tl.load(space + 1), tl.load(space + 2)
    if KIND == 2:
        i = 1.0 / tl.maximum(pz, s2 * 0.5)
        x = 0.5 + 0.5 * px * i / s0
        y = 0.5 + 0.5 * py * i / s1
        z = 1.0 - s2 * i
        jacobian = s2 * i * i
        along_x = tl.abs(0.5 * (dx - px * i * dz) * i / s0)
        along_y = tl.abs(0.5 * (dy - py * i * dz) * i / s1)
        speed = tl.maximum(tl.maximum(along_x, along_y), tl.abs(jacobian * dz))
    else:
        s3, s4, s5, s6 = tl.load(space + 3), tl.load(space + 4), tl.load(space + 5), tl.load(space + 6)
        x, y, z = (px - s0) * s3, (py - s1) * s4, (pz - s2) * s5
        vx, vy, vz = dx * s3, dy * s4, dz * s5
        if KIND == 0:
            jacobian = s6 + 0.0 * px
            speed = tl.maximum(tl.maximum(tl.abs(vx), tl.abs(vy)), tl.abs(vz))
        else:
            # x' = x (2 - 1/m)/m with m the largest coordinate; dm/dt is that coordinate's own velocity.
            m = tl.maximum(tl.maximum(tl.abs(x), tl.abs(y)), tl.abs(z))
            outside = m > 1.0
            i = 1.0 / tl.maximum(m, 1.0)
            s = tl.where(outside, (2.0 - i) * i, 1.0)
            of_y = tl.where(tl.abs(y) == m, tl.where(y > 0, vy, -vy), tl.where(z > 0, vz, -vz))
            dm = tl.where(tl.abs(x) == m, tl.where(x > 0, vx, -vx), of_y)
            ds = tl.where(outside, 2.0 * (i - 1.0) * i * i * dm, 0.0)
            vx, vy, vz = vx * s + x * ds, vy * s + y * ds, vz * s + z * ds
            x, y, z = 0.5 + 0.25 * x * s, 0.5 + 0.25 * y * s, 0.5 + 0.25 * z * s
            jacobian = 0.25 * s6 * tl.where(outside, i * i, 1.0)
            speed = 0.25 * tl.maximum(tl.maximum(tl.abs(vx), tl.abs(vy)), tl.abs(vz))
    return clamped(x), clamped(y), clamped(z), tl.maximum(speed, SMALLEST), jacobian


@triton.jit
def _clip_axis(o, d, low, scale, t0, t1):
    p, v = (o - low) * scale, d * scale
    parallel = tl.abs(v) < SMALLEST
    # Lanes cannot branch: parallel rays divide by 1, and the results are not used.
    i = 1.0 / tl.where(parallel, 1.0, v)
    u, w = -p * i, (1.0 - p) * i
    missed = parallel & ((p < 0.0) | (p > 1.0))
    begin = tl.where(parallel, t0, tl.maximum(t0, tl.minimum(u, w)))
    end = tl.where(parallel, t1, tl.minimum(t1, tl.maximum(u, w)))
    return begin, tl.where(missed, -1.0, end)


@triton.jit
def _clip_side(p, v, t0, t1):
    """Clip a ray to above a plane. p: height of its origin above the plane; v: change of that height along the ray."""
    falling, rising = v < -SMALLEST, v >= SMALLEST
    # Lanes cannot branch: the others divide by 1, and the results are not used.
    crossing = -p / tl.where(falling | rising, v, 1.0)
    begin = tl.where(rising & (p < 0.0), tl.maximum(t0, crossing), t0)
    end = tl.where(falling, tl.minimum(t1, crossing), t1)
    return begin, tl.where((v < SMALLEST) & (p < 0.0), -1.0, end)


@triton.jit
def ray_span(KIND: tl.constexpr, space, ox, oy, oz, dx, dy, dz, near, far):
    """Range of distances to march; empty if the first is not less than the second."""
    t0, t1 = near, far + 0.0 * near
    if KIND == 0:
        t0, t1 = _clip_axis(ox, dx, tl.load(space), tl.load(space + 3), t0, t1)
        t0, t1 = _clip_axis(oy, dy, tl.load(space + 1), tl.load(space + 4), t0, t1)
        t0, t1 = _clip_axis(oz, dz, tl.load(space + 2), tl.load(space + 5), t0, t1)
    elif KIND == 2:
        wide, high = tl.load(space) * FRUSTUM_MARGIN, tl.load(space + 1) * FRUSTUM_MARGIN
        t0, t1 = _clip_side(oz - tl.load(space + 2) * 0.5, dz, t0, t1)
        t0, t1 = _clip_side(wide * oz - ox, wide * dz - dx, t0, t1)
        t0, t1 = _clip_side(wide * oz + ox, wide * dz + dx, t0, t1)
        t0, t1 = _clip_side(high * oz - oy, high * dz - dy, t0, t1)
        t0, t1 = _clip_side(high * oz + oy, high * dz + dy, t0, t1)
    return t0, t1


@triton.jit
def time_of(KIND: tl.constexpr, steps, step, speed, pz, dz):
    """Change of distance along a ray over `steps` steps; exact in a frustum, where the speed falls with 1/z^2.

    BEYOND if the cube ends earlier.
    """
    time = steps * step / speed
    if KIND == 2:
        left = speed - steps * step * dz / pz
        time = tl.where(left > 0.0, steps * step / tl.where(left > 0.0, left, 1.0), BEYOND)
    return time


@triton.jit
def empty_steps(KIND: tl.constexpr, space, ox, oy, oz, dx, dy, dz, t, dt, distance, cells, step, qx, qy, qz, mask):
    """Steps (int32) to skip if the nearest occupied cell is `distance` cells away; see march_partition on the CPU.

    Lanes excluded by `mask` or next to an occupied cell take one step.
    """
    far = mask & (distance > 1)
    reach = (distance.to(tl.float32) - 1.0) / cells
    steps = tl.where(far, tl.maximum((reach / step).to(tl.int32), 1), 1)
    if KIND == 1:
        reach = reach * 0.95
        # Halved until what is moved in the cube is within reach; thirty-one halvings bring every int32 to one.
        pending = (steps > 1).to(tl.int32)
        while tl.max(pending, axis=0) > 0:
            s = t + dt * steps.to(tl.float32)
            ax, ay, az, _speed, _jacobian = warp_at(KIND, space, ox + s * dx, oy + s * dy, oz + s * dz, dx, dy, dz)
            moved = tl.maximum(tl.maximum(tl.abs(ax - qx), tl.abs(ay - qy)), tl.abs(az - qz))
            too_far = (pending > 0) & (moved > reach)
            steps = tl.where(too_far, steps // 2, steps)
            pending = (too_far & (steps > 1)).to(tl.int32)
    return steps


@triton.jit
def cell_number(x, y, z, cells):
    """Row-major index of the occupancy cell that contains a cube point."""
    i = tl.minimum((x * cells).to(tl.int32), cells - 1)
    j = tl.minimum((y * cells).to(tl.int32), cells - 1)
    k = tl.minimum((z * cells).to(tl.int32), cells - 1)
    return (i.to(tl.int64) * cells + j) * cells + k


@triton.jit
def displaced(grid, cells, x, y, z, mask):
    """x + trilinear(grid, x), clamped to the cube; grid: flat [cells^3, 3] on vertices."""
    i, fx = cell(x, cells)
    j, fy = cell(y, cells)
    k, fz = cell(z, cells)
    at = (i.to(tl.int64) * cells + j) * cells + k
    for corner in tl.static_range(8):
        w = trilinear_corner(corner, fx, fy, fz)
        there = at + ((corner // 4) * cells + (corner // 2) % 2) * cells + corner % 2
        a, b, c = vector(grid, there, mask)
        x, y, z = x + w * a, y + w * b, z + w * c
    return clamped(x), clamped(y), clamped(z)


@triton.jit
def _keep(t_out, deltas, points, sigma, weights, ray_of, at, t, delta, x, y, z, s, w, ray, mask):
    tl.store(t_out + at, t, mask=mask)
    tl.store(deltas + at, delta, mask=mask)
    store_vector(points, at, x, y, z, mask)
    tl.store(sigma + at, s, mask=mask)
    tl.store(weights + at, w, mask=mask)
    tl.store(ray_of + at, ray, mask=mask)


@triton.jit
def _fitting(counts, last, capacity, r, valid):
    """(begin, samples) of the rays, from their counts and cumulative counts; no samples for rays that do not fit."""
    wanted = tl.load(counts + r, mask=valid, other=0)
    begin = tl.load(last + r, mask=valid, other=0).to(tl.int64) - wanted
    fits = begin + wanted <= capacity
    return tl.where(fits, begin, 0), tl.where(fits, wanted, 0)


@triton.jit
def _fill_up(t_out, deltas, points, sigma, weights, ray_of, begin, found, most, r):
    """Write zeros where a ray has fewer samples than counted, since the launches may differ by rounding."""
    zero = 0.0 * found.to(tl.float32)
    while tl.max((found < most).to(tl.int32), axis=0) > 0:
        lacks = found < most
        _keep(
            t_out, deltas, points, sigma, weights, ray_of, begin + found, zero, zero, zero, zero, zero, zero, zero, r,
            lacks,
        )  # fmt: skip
        found = tl.where(lacks, found + 1, found)


@triton.jit(
    do_not_specialize=[*SIZES, "cells", "samples_per_ray", "grid_cells", "rays", "capacity"],
    do_not_specialize_on_alignment=["shift"],
)
def march_kernel(
    space, origins, directions, jitter, near, far, step, occupancy, cells, samples_per_ray, min_transmittance,
    table, shift, s0, s1, s2, layout, grid, grid_cells,
    counts, last, capacity, starts, ends, largest, total, t_out, deltas, points, sigma, weights, ray_of, rays,
    KIND: tl.constexpr, OPAQUE_BACKGROUND: tl.constexpr, DISPLACED: tl.constexpr, FILL: tl.constexpr,
    DENSITY: tl.constexpr, RANK: tl.constexpr, WIDTH: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """FILL false: counts[r] = samples of ray r. true: with last[r] the sum of counts up to r, write the samples.

    Ray r's samples are then starts[r]:ends[r] of t_out, deltas, points, sigma, weights, ray_of; largest[r] is its
    largest weight; total[0], initially zero, becomes the end of the last ray that fits. near: one number for all rays.
    table to layout, DENSITY, RANK, WIDTH: the density, see tables.raw_density.
    """
    # Both launches run this loop: enter, skip or sample until all lanes are done, then the background's sample.
    r = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    valid = r < rays
    ox, oy, oz = vector(origins, r, valid)
    dx, dy, dz = vector(directions, r, valid)
    t, end = ray_span(KIND, space, ox, oy, oz, dx, dy, dz, near + 0.0 * ox, far)
    end = tl.where(valid, end, -1.0)  # lanes beyond the last ray never march
    most = tl.where(valid, samples_per_ray, 0)
    begin = r.to(tl.int64) * 0
    if FILL:
        begin, most = _fitting(counts, last, capacity, r, valid)
    open_ray = t < end
    _x, _y, _z, speed, _j = warp_at(KIND, space, ox + t * dx, oy + t * dy, oz + t * dz, dx, dy, dz)
    offset = tl.load(jitter + r, mask=valid, other=0.0)
    t = tl.where(open_ray, t + time_of(KIND, offset, step, speed, oz + t * dz, dz), t)
    transmittance = 1.0 + 0.0 * t
    peak = 0.0 * t
    newest = 0.0 * t  # weight
    found = r * 0
    turns = 0
    marching = ((t < end) & (found < most)).to(tl.int32)
    while tl.max(marching, axis=0) > 0:
        active = marching > 0
        x, y, z, speed, jacobian = warp_at(KIND, space, ox + t * dx, oy + t * dy, oz + t * dz, dx, dy, dz)
        dt = step / speed
        distance = tl.load(occupancy + cell_number(x, y, z, cells), mask=active, other=0).to(tl.int32)
        hit = active & (distance == 0)
        taken = empty_steps(KIND, space, ox, oy, oz, dx, dy, dz, t, dt, distance, cells, step, x, y, z, active)
        if tl.max(hit.to(tl.int32), axis=0) > 0:
            if DISPLACED:
                x, y, z = displaced(grid, grid_cells, x, y, z, hit)
            s = raw_density(table, layout, shift, x, y, z, s0, s1, s2, hit, DENSITY, RANK, WIDTH)
            delta = dt * jacobian * SCALE
            transmitted = tl.exp(-s * delta)
            w = transmittance * (1.0 - transmitted)
            if FILL:
                _keep(t_out, deltas, points, sigma, weights, ray_of, begin + found, t, delta, x, y, z, s, w, r, hit)
                peak = tl.where(hit, tl.maximum(peak, w), peak)
                newest = tl.where(hit, w, newest)
            transmittance = tl.where(hit, transmittance * transmitted, transmittance)
            found = tl.where(hit, found + 1, found)
        # `taken` is 1 after a sample.
        t = tl.where(active, t + time_of(KIND, taken.to(tl.float32), step, speed, oz + t * dz, dz), t)
        turns += 1
        lit = transmittance >= min_transmittance
        marching = ((t < end) & lit & (found < most) & (turns < MOST_TURNS)).to(tl.int32)
    if OPAQUE_BACKGROUND:
        # The far end absorbs the remaining light; its density is fixed: only its color learns.
        x, y, z, speed, jacobian = warp_at(KIND, space, ox + end * dx, oy + end * dy, oz + end * dz, dx, dy, dz)
        lit = transmittance >= min_transmittance
        takes = valid & lit & (found < most)
        zero = 0.0 * t
        if FILL:
            _keep(
                t_out, deltas, points, sigma, weights, ray_of, begin + found, end, zero, x, y, z, zero,
                transmittance, r, takes,
            )  # fmt: skip
            peak = tl.where(takes, tl.maximum(peak, transmittance), peak)
            # Rounding gave this pass a sample in the background's place: it absorbs the remaining light too.
            crowded = lit & (found == most) & (most > 0) & (most < samples_per_ray) & (takes == 0)
            tl.store(weights + begin + found - 1, newest + transmittance, mask=crowded)
            peak = tl.where(crowded, tl.maximum(peak, newest + transmittance), peak)
        found = tl.where(takes, found + 1, found)
    if FILL:
        tl.store(starts + r, begin, mask=valid)
        tl.store(ends + r, begin + most, mask=valid)
        tl.store(largest + r, peak, mask=valid)
        tl.atomic_max(total, tl.max(tl.where(most > 0, begin + most, 0), axis=0), sem="relaxed")
        _fill_up(t_out, deltas, points, sigma, weights, ray_of, begin, found, most, r)
    else:
        tl.store(counts + r, found, mask=valid)
