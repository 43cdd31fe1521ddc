"""Raw density of any kind at points, inside the march and alone; the kind is a constant of the kernel."""

import triton
import triton.language as tl

from stylerf.kernels.gpu.hash_density import raw_density as hash_density
from stylerf.kernels.gpu.indexing import vector
from stylerf.kernels.gpu.vm import SIZES
from stylerf.kernels.gpu.vm import raw_density as vm_density
from stylerf.kernels.gpu.voxel import raw_density as voxel_density

VM, HASH, VOXEL = tl.constexpr(0), tl.constexpr(1), tl.constexpr(2)


@triton.jit
def raw_density(
    table, layout, shift, x, y, z, s0, s1, s2, valid,
    DENSITY: tl.constexpr, RANK: tl.constexpr, WIDTH: tl.constexpr,
):  # fmt: skip
    """exp(shift + features) of points.

    layout, RANK: not read and the rank (vm); the levels' and how many (hash); links and one (voxel). s0, s1, s2:
    vertices per axis of vm's and voxels' grids. WIDTH: columns of a tile.
    """
    if DENSITY == VM:
        sigma = vm_density(table, shift, x, y, z, s0, s1, s2, valid, RANK, WIDTH)
    elif DENSITY == HASH:
        sigma = hash_density(table, layout, shift, x, y, z, valid, RANK, WIDTH)
    else:
        sigma = voxel_density(table, layout, shift, x, y, z, s0, s1, s2, valid)
    return sigma


@triton.jit(do_not_specialize=[*SIZES, "count"], do_not_specialize_on_alignment=["shift"])
def density_kernel(
    table, layout, shift, points, sigma, count, s0, s1, s2,
    DENSITY: tl.constexpr, RANK: tl.constexpr, WIDTH: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """sigma[k] of points [count, 3]."""
    k = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    valid = k < count
    x, y, z = vector(points, k, valid)
    s = raw_density(table, layout, shift, x, y, z, s0, s1, s2, valid, DENSITY, RANK, WIDTH)
    tl.store(sigma + k, s, mask=valid)
