"""Ray marching through warped space and over empty cells to packed samples with density and weights.

One lane per ray, BLOCK rays per program, two launches of one kernel: the first counts samples, the second, after a
cumulative sum of the counts, writes them. Rays whose samples would not fit get none. The room is fixed before the
launch, so that the number of samples need not be read back.
"""

import triton
import triton.language as tl

from stylerf.kernels.cpu.march import OPTICAL_SCALE
from stylerf.kernels.gpu.density import raw_density
from stylerf.kernels.gpu.indexing import cell, offset, store_vector, trilinear_corner, vector
from stylerf.kernels.gpu.space_warp import cell_number, empty_steps, ray_span, warp_at
from stylerf.kernels.gpu.vm import SIZES

SCALE = tl.constexpr(float(OPTICAL_SCALE))
MOST_TURNS = tl.constexpr(1 << 16)  # a step too small for float32 to move the ray must not hang the GPU


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
    x = tl.minimum(tl.maximum(x, 0.0), 1.0)
    y = tl.minimum(tl.maximum(y, 0.0), 1.0)
    z = tl.minimum(tl.maximum(z, 0.0), 1.0)
    return x, y, z


@triton.jit
def _keep(t_out, deltas, points, sigma, weights, ray_of, at, t, delta, x, y, z, s, w, ray, mask):
    tl.store(t_out + at, t, mask=mask)
    tl.store(deltas + at, delta, mask=mask)
    store_vector(points, at, x, y, z, mask)
    tl.store(sigma + at, s, mask=mask)
    tl.store(weights + at, w, mask=mask)
    tl.store(ray_of + at, ray, mask=mask)


@triton.jit(
    do_not_specialize=[*SIZES, "cells", "samples_per_ray", "grid_cells", "rays", "room"],
    do_not_specialize_on_alignment=["shift"],
)
def march_kernel(
    space, origins, directions, jitter, near, far, step, occupancy, cells, samples_per_ray, min_transmittance,
    table, shift, s0, s1, s2, layout, grid, grid_cells,
    counts, last, room, starts, ends, largest, total, t_out, deltas, points, sigma, weights, ray_of, rays,
    KIND: tl.constexpr, OPAQUE_BACKGROUND: tl.constexpr, DISPLACED: tl.constexpr, FILL: tl.constexpr,
    DENSITY: tl.constexpr, RANK: tl.constexpr, WIDTH: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """FILL false: counts[r] = samples of ray r. true: with last[r] the sum of counts up to r, write the samples.

    Then ray r's are starts[r]:ends[r] of t_out, deltas, points, sigma, weights, ray_of; largest[r] is its largest
    weight; total[0], zero before, is raised to the end of the last ray that found room. near: one number for all rays.
    table to layout, DENSITY, RANK, WIDTH: the density, see density.raw_density.
    """
    r = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    valid = r < rays
    ox, oy, oz = vector(origins, r, valid)
    dx, dy, dz = vector(directions, r, valid)
    t, end = ray_span(KIND, space, ox, oy, oz, dx, dy, dz, near + 0.0 * ox, far)
    end = tl.where(valid, end, -1.0)
    most = tl.where(valid, samples_per_ray, 0)
    begin = r.to(tl.int64) * 0
    if FILL:
        wanted = tl.load(counts + r, mask=valid, other=0)
        begin = tl.load(last + r, mask=valid, other=0).to(tl.int64) - wanted
        fits = begin + wanted <= room
        most = tl.where(fits, wanted, 0)
        begin = tl.where(fits, begin, 0)
    open_ray = t < end
    _x, _y, _z, speed, _j = warp_at(KIND, space, ox + t * dx, oy + t * dy, oz + t * dz, dx, dy, dz)
    t = tl.where(open_ray, t + tl.load(jitter + r, mask=valid, other=0.0) * step / speed, t)
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
        t = tl.where(active, t + dt * taken.to(tl.float32), t)
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
        # The launches may differ by rounding: samples that this one lacks must not be left unwritten.
        while tl.max((found < most).to(tl.int32), axis=0) > 0:
            lacks = found < most
            zero = 0.0 * t
            _keep(
                t_out, deltas, points, sigma, weights, ray_of, begin + found, zero, zero, zero, zero, zero, zero,
                zero, r, lacks,
            )  # fmt: skip
            found = tl.where(lacks, found + 1, found)
    else:
        tl.store(counts + r, found, mask=valid)


@triton.jit(do_not_specialize=["count"])
def warp_kernel(space, world, out, jacobians, count, KIND: tl.constexpr, BLOCK: tl.constexpr):
    """Positions in the cube and density jacobians of free points [count, 3]."""
    k = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    valid = k < count
    px, py, pz = vector(world, k, valid)
    x, y, z, _speed, jacobian = warp_at(KIND, space, px, py, pz, 1.0 + 0.0 * px, 0.0 * px, 0.0 * px)
    store_vector(out, k, x, y, z, valid)
    tl.store(jacobians + k, jacobian, mask=valid)


@triton.jit(do_not_specialize=["width", "column"])
def offsets_kernel(rows, out, width, column, BLOCK: tl.constexpr):
    """out[i] = offset(rows[i], width, column): for the test of what lies beyond 2^31."""
    i = tl.arange(0, BLOCK)
    tl.store(out + i, offset(tl.load(rows + i), width, column))
