"""Regions on packed samples (kernels/cpu/regions.py): the part of each ray inside, and their own colors.

marked: uint8 [cells^3]. box: float32 [4], the lower corner of the cells' bounding cube and the inverse of its side,
which map a sample to the region's own grid.
"""

import triton
import triton.language as tl

from stylerf.kernels.cpu import regions
from stylerf.kernels.gpu.compositing import rays_of_program
from stylerf.kernels.gpu.hash_color import lane_gradients, level_scatter, level_sum, logit
from stylerf.kernels.gpu.indexing import offset, vector
from stylerf.kernels.gpu.march import cell_number, clamped
from stylerf.kernels.gpu.shading import sigmoid, to_learn

MIN_ODDS = tl.constexpr(float(regions.MIN_ODDS))


@triton.jit
def in_marked(marked, cells, x, y, z, mask):
    """Which of the cube points in `mask` are in marked cells."""
    return mask & (tl.load(marked + cell_number(x, y, z, cells), mask=mask, other=0) != 0)


@triton.jit(do_not_specialize=["cells"])
def keep_kernel(marked, cells, points, total, values, BLOCK: tl.constexpr):
    """values[k] = 0 for samples outside marked cells; total: pointer to the number of samples."""
    count = tl.load(total)
    for block in range(tl.program_id(0).to(tl.int64), tl.cdiv(count, BLOCK), tl.num_programs(0)):
        k = block * BLOCK + tl.arange(0, BLOCK)
        inside = k < count
        x, y, z = vector(points, k, inside)
        own = in_marked(marked, cells, x, y, z, inside)
        tl.store(values + k, 0.0, mask=inside & (own == 0))


@triton.jit(do_not_specialize=["cells"])
def mark_kernel(points, weights, deltas, total, min_weight, cells, marked, BLOCK: tl.constexpr):
    """marked[cell] = 1 for the cells of samples with a weight of at least `min_weight`; see mark_cells on the CPU."""
    count = tl.load(total)
    for block in range(tl.program_id(0).to(tl.int64), tl.cdiv(count, BLOCK), tl.num_programs(0)):
        k = block * BLOCK + tl.arange(0, BLOCK)
        inside = k < count
        heavy = tl.load(weights + k, mask=inside, other=0.0) >= min_weight
        heavy = inside & heavy & (tl.load(deltas + k, mask=inside, other=0.0) > 0.0)
        x, y, z = vector(points, k, heavy)
        tl.store(marked + cell_number(x, y, z, cells), 1, mask=heavy)


@triton.jit(do_not_specialize=["cells", "rays"])
def ends_kernel(marked, cells, points, t, weights, starts, ends, out, rays, BLOCK: tl.constexpr):
    """out[r] = (sum w, sum over marked cells of w, of w t, of w x): [rays, 6], zero for a ray without samples."""
    r, valid, first, count = rays_of_program(starts, ends, rays, BLOCK)
    zero = first.to(tl.float32) * 0.0
    whole, inside, depth, at_x, at_y, at_z = zero, zero, zero, zero, zero, zero
    for i in range(0, tl.max(count, axis=0)):
        own = i < count
        k = first + i
        w = tl.load(weights + k, mask=own, other=0.0)
        x, y, z = vector(points, k, own)
        whole += w
        w = tl.where(in_marked(marked, cells, x, y, z, own), w, 0.0)
        inside += w
        depth += w * tl.load(t + k, mask=own, other=0.0)
        at_x += w * x
        at_y += w * y
        at_z += w * z
    at = offset(r, 6, 0)
    tl.store(out + at, whole, mask=valid)
    tl.store(out + at + 1, inside, mask=valid)
    tl.store(out + at + 2, depth, mask=valid)
    tl.store(out + at + 3, at_x, mask=valid)
    tl.store(out + at + 4, at_y, mask=valid)
    tl.store(out + at + 5, at_z, mask=valid)


@triton.jit
def into_box(box, x, y, z):
    """Positions in the box, 0..1, of cube points."""
    side = tl.load(box + 3)
    x, y, z = (x - tl.load(box)) * side, (y - tl.load(box + 1)) * side, (z - tl.load(box + 2)) * side
    return clamped(x), clamped(y), clamped(z)


@triton.jit(do_not_specialize=["cells"])
def color_kernel(
    table, layout, marked, cells, box, points, total, out, LEVELS: tl.constexpr, BLOCK: tl.constexpr
):  # fmt: skip
    """out [n, 3] = sigmoid(logit(out) + f) for colored samples (out[k, 0] >= 0) in marked cells."""
    count = tl.load(total)
    lane = tl.arange(0, 4)
    for block in range(tl.program_id(0).to(tl.int64), tl.cdiv(count, BLOCK), tl.num_programs(0)):
        k = block * BLOCK + tl.arange(0, BLOCK)
        colored = tl.load(out + offset(k, 3, 0), mask=k < count, other=-1.0) >= 0.0
        x, y, z = vector(points, k, colored)
        valid = in_marked(marked, cells, x, y, z, colored)
        if tl.max(valid.to(tl.int32), axis=0) > 0:
            x, y, z = into_box(box, x, y, z)
            f = x[:, None] * 0.0 + lane[None, :] * 0.0
            for level in tl.static_range(LEVELS):
                f += level_sum(table, layout, level, LEVELS, x, y, z, valid)
            for j in tl.static_range(3):
                at = out + offset(k, 3, j)
                own = sigmoid(logit(f, lane, j))
                base = tl.minimum(tl.maximum(tl.load(at, mask=valid, other=0.5), MIN_ODDS), 1.0 - MIN_ODDS)
                both = base * own
                # sigmoid(logit(p) + logit(q)) = p q / (p q + (1 - p)(1 - q)), without logarithms.
                tl.store(at, both / (both + (1.0 - base) * (1.0 - own)), mask=valid)


@triton.jit(do_not_specialize=["cells"])
def color_backward_kernel(
    layout, marked, cells, box, points, colors, color_gradients, total, to,
    LEVELS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Add dL/d(table) of colored samples in marked cells.

    A sigmoid's derivative follows from its value alone.
    """
    count = tl.load(total)
    lane = tl.arange(0, 4)
    for block in range(tl.program_id(0).to(tl.int64), tl.cdiv(count, BLOCK), tl.num_programs(0)):
        k = block * BLOCK + tl.arange(0, BLOCK)
        colored, g0, g1, g2 = to_learn(k, k < count, colors, color_gradients)
        x, y, z = vector(points, k, colored)
        valid = in_marked(marked, cells, x, y, z, colored)
        if tl.max(valid.to(tl.int32), axis=0) > 0:
            g = lane_gradients(lane, g0, g1, g2)
            x, y, z = into_box(box, x, y, z)
            for level in tl.static_range(LEVELS):
                level_scatter(to, layout, level, LEVELS, x, y, z, g, valid)
