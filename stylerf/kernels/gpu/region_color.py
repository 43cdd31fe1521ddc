"""Colors of marked cells that add their logits to others': kernels/cpu/region_color.py and hash_color.py in one pass
each way.

box: float32 [4], the lowest corner of the cells' box and one over its side: where in its own grid a sample lies.
"""

import triton
import triton.language as tl

from stylerf.kernels.gpu.hash_color import lane_gradients, level_scatter, level_sum, logit
from stylerf.kernels.gpu.indexing import offset, vector
from stylerf.kernels.gpu.regions import in_marked
from stylerf.kernels.gpu.space_warp import _unit
from stylerf.kernels.gpu.vm import _sigmoid

LEAST = tl.constexpr(1e-4)  # odds at least, both ways: white and black can be repainted too


@triton.jit
def into_box(box, x, y, z):
    """Positions in the box, 0..1, of points in the cube."""
    side = tl.load(box + 3)
    x, y, z = (x - tl.load(box)) * side, (y - tl.load(box + 1)) * side, (z - tl.load(box + 2)) * side
    return _unit(x), _unit(y), _unit(z)


@triton.jit(do_not_specialize=["cells"])
def color_kernel(
    table, layout, marked, cells, box, points, total, out, LEVELS: tl.constexpr, BLOCK: tl.constexpr
):  # fmt: skip
    """out [n, 3] = sigmoid(logit(out) + f) of samples in marked cells that have a color (out[k, 0] >= 0)."""
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
                own = _sigmoid(logit(f, lane, j))
                base = tl.minimum(tl.maximum(tl.load(at, mask=valid, other=0.5), LEAST), 1.0 - LEAST)
                both = base * own
                tl.store(at, both / (both + (1.0 - base) * (1.0 - own)), mask=valid)


@triton.jit(do_not_specialize=["cells"])
def color_backward_kernel(
    layout, marked, cells, box, points, colors, color_gradients, total, to,
    LEVELS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Add dL/d(table) of samples in marked cells that have a color.

    A sigmoid's slope follows from its value alone.
    """
    count = tl.load(total)
    lane = tl.arange(0, 4)
    for block in range(tl.program_id(0).to(tl.int64), tl.cdiv(count, BLOCK), tl.num_programs(0)):
        k = block * BLOCK + tl.arange(0, BLOCK)
        colored = tl.load(colors + offset(k, 3, 0), mask=k < count, other=-1.0) >= 0.0
        x, y, z = vector(points, k, colored)
        valid = in_marked(marked, cells, x, y, z, colored)
        if tl.max(valid.to(tl.int32), axis=0) > 0:
            g = lane_gradients(colors, color_gradients, k, lane, valid)
            x, y, z = into_box(box, x, y, z)
            for level in tl.static_range(LEVELS):
                level_scatter(to, layout, level, LEVELS, x, y, z, g, valid)
