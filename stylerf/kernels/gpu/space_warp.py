"""The warp of space, span of a ray and leaps: kernels/cpu/march.py, a lane to a ray."""

import triton
import triton.language as tl

TINY = tl.constexpr(1e-9)


@triton.jit
def _unit(x):
    return tl.minimum(tl.maximum(x, 0.0), 1.0)


@triton.jit
def warp_at(KIND: tl.constexpr, space, px, py, pz, dx, dy, dz):
    """(x, y, z in the cube, speed along (dx, dy, dz), density jacobian); see the CPU's warp_at.

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
    return _unit(x), _unit(y), _unit(z), tl.maximum(speed, TINY), jacobian


@triton.jit
def _clip_axis(o, d, low, scale, t0, t1):
    p, v = (o - low) * scale, d * scale
    parallel = tl.abs(v) < TINY
    i = 1.0 / tl.where(parallel, 1.0, v)
    u, w = -p * i, (1.0 - p) * i
    missed = parallel & ((p < 0.0) | (p > 1.0))
    begin = tl.where(parallel, t0, tl.maximum(t0, tl.minimum(u, w)))
    end = tl.where(parallel, t1, tl.minimum(t1, tl.maximum(u, w)))
    return begin, tl.where(missed, -1.0, end)


@triton.jit
def ray_span(KIND: tl.constexpr, space, ox, oy, oz, dx, dy, dz, near, far):
    """Distances between which a ray is marched; empty where the first is not less than the second."""
    t0, t1 = near, far + 0.0 * near
    if KIND == 0:
        t0, t1 = _clip_axis(ox, dx, tl.load(space), tl.load(space + 3), t0, t1)
        t0, t1 = _clip_axis(oy, dy, tl.load(space + 1), tl.load(space + 4), t0, t1)
        t0, t1 = _clip_axis(oz, dz, tl.load(space + 2), tl.load(space + 5), t0, t1)
    return t0, t1


@triton.jit
def empty_steps(KIND: tl.constexpr, space, ox, oy, oz, dx, dy, dz, t, dt, distance, cells, step, qx, qy, qz, mask):
    """Steps (int32) that can be taken at once where the nearest occupied cell is `distance` cells away; see the CPU's.

    Lanes that `mask` leaves out, or that stand beside an occupied cell, take one.
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
    """Row-major number of the occupancy cell of a point of the cube."""
    i = tl.minimum((x * cells).to(tl.int32), cells - 1)
    j = tl.minimum((y * cells).to(tl.int32), cells - 1)
    k = tl.minimum((z * cells).to(tl.int32), cells - 1)
    return (i.to(tl.int64) * cells + j) * cells + k
