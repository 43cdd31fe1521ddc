"""What of a ray lies in a region: kernels/cpu/regions.py, on packed samples. marked: uint8 [cells^3] over the cube."""

import triton
import triton.language as tl

from stylerf.kernels.gpu.indexing import offset, vector
from stylerf.kernels.gpu.space_warp import cell_number


@triton.jit
def in_marked(marked, cells, x, y, z, mask):
    """Which of the points of the cube that `mask` asks for lie in marked cells."""
    return mask & (tl.load(marked + cell_number(x, y, z, cells), mask=mask, other=0) != 0)


@triton.jit(do_not_specialize=["cells"])
def keep_kernel(marked, cells, points, total, values, BLOCK: tl.constexpr):
    """values[k] = 0 for samples whose cell is not marked; total: pointer to the number of samples."""
    count = tl.load(total)
    for block in range(tl.program_id(0).to(tl.int64), tl.cdiv(count, BLOCK), tl.num_programs(0)):
        k = block * BLOCK + tl.arange(0, BLOCK)
        inside = k < count
        x, y, z = vector(points, k, inside)
        own = in_marked(marked, cells, x, y, z, inside)
        tl.store(values + k, 0.0, mask=inside & (own == 0))


@triton.jit(do_not_specialize=["cells", "rays"])
def ends_kernel(marked, cells, points, t, weights, starts, ends, out, rays, BLOCK: tl.constexpr):
    """out[r] = (sum w, sum over marked cells of w, of w t, of w x): [rays, 6], zero for a ray without samples."""
    r = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    valid = r < rays
    first = tl.load(starts + r, mask=valid, other=0)
    count = tl.load(ends + r, mask=valid, other=0) - first
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
