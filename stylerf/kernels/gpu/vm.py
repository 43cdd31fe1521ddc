"""Vector-matrix tables on tiles of samples by ranks (kernels/cpu/vm.py).

WIDTH: the rank rounded up to a power of two, at least 16.
"""

import triton
import triton.language as tl

from stylerf.kernels.gpu.indexing import cell, offset


@triton.jit
def place(m: tl.constexpr, x, y, z, s0, s1, s2):
    """Rows of plane m and of its line at a point: (upper, lower plane row, line row: int64, fu, fv, fw)."""
    planes = s0.to(tl.int64) * s1 + s1.to(tl.int64) * s2 + s2.to(tl.int64) * s0
    if m == 0:
        u, v, w, su, sv, sw = y, z, x, s1, s2, s0
        before, lines = planes * 0, planes
    elif m == 1:
        u, v, w, su, sv, sw = z, x, y, s2, s0, s1
        before, lines = s1.to(tl.int64) * s2, planes + s0
    else:
        u, v, w, su, sv, sw = x, y, z, s0, s1, s2
        before, lines = s1.to(tl.int64) * s2 + s2.to(tl.int64) * s0, planes + s0 + s1
    iu, fu = cell(u, su)
    iv, fv = cell(v, sv)
    iw, fw = cell(w, sw)
    first = before + iu.to(tl.int64) * sv + iv
    return first, first + sv, lines + iw, fu[:, None], fv[:, None], fw[:, None]


@triton.jit
def tile(table, row, columns, RANK: tl.constexpr, mask):
    """Rows of the table as float32 [samples, WIDTH]; the table may be in half precision."""
    at = offset(row[:, None], RANK, columns[None, :])
    return tl.load(table + at, mask=mask, other=0.0).to(tl.float32)


@triton.jit
def product(table, first, second, line, fu, fv, fw, columns, RANK: tl.constexpr, mask):
    """(plane, line) [samples, WIDTH]: bilinear and linear interpolation; their product is the plane's feature."""
    upper = (1.0 - fv) * tile(table, first, columns, RANK, mask) + fv * tile(table, first + 1, columns, RANK, mask)
    lower = (1.0 - fv) * tile(table, second, columns, RANK, mask) + fv * tile(table, second + 1, columns, RANK, mask)
    along = (1.0 - fw) * tile(table, line, columns, RANK, mask) + fw * tile(table, line + 1, columns, RANK, mask)
    return (1.0 - fu) * upper + fu * lower, along


@triton.jit
def scatter(to, first, second, line, fu, fv, fw, plane, along, gradient, columns, RANK: tl.constexpr, mask):
    """Add gradient [samples, WIDTH] times d(plane * along) to the rows of `to`, laid out as the table."""
    # Product rule: d(P L) = L dP + P dL.
    dp, dl = gradient * along, gradient * plane
    upper, lower, ends = first[:, None], second[:, None], line[:, None]
    at = columns[None, :]
    tl.atomic_add(to + offset(upper, RANK, at), (1.0 - fu) * (1.0 - fv) * dp, mask=mask, sem="relaxed")
    tl.atomic_add(to + offset(upper + 1, RANK, at), (1.0 - fu) * fv * dp, mask=mask, sem="relaxed")
    tl.atomic_add(to + offset(lower, RANK, at), fu * (1.0 - fv) * dp, mask=mask, sem="relaxed")
    tl.atomic_add(to + offset(lower + 1, RANK, at), fu * fv * dp, mask=mask, sem="relaxed")
    tl.atomic_add(to + offset(ends, RANK, at), (1.0 - fw) * dl, mask=mask, sem="relaxed")
    tl.atomic_add(to + offset(ends + 1, RANK, at), fw * dl, mask=mask, sem="relaxed")


@triton.jit(do_not_specialize=["rows", "columns", "begin"])
def smoothness_kernel(
    table, to, strength, rows, columns, begin, RANK: tl.constexpr, WIDTH: tl.constexpr, BLOCK: tl.constexpr
):
    """Add strength * d/dt of half the sum of squared differences of one plane's neighboring texels to `to`.

    begin: the plane's first row in the table; one texel per row of the tile.
    """
    n = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    rank = tl.arange(0, WIDTH)
    i, j = n // columns, n % columns
    valid = (n < rows.to(tl.int64) * columns)[:, None] & (rank[None, :] < RANK)
    here = tile(table, begin + n, rank, RANK, valid)
    total = here * 0.0
    for side in tl.static_range(4):
        if side == 0:
            there, known = n - columns, i > 0
        elif side == 1:
            there, known = n + columns, i < rows - 1
        elif side == 2:
            there, known = n - 1, j > 0
        else:
            there, known = n + 1, j < columns - 1
        both = valid & known[:, None]
        total += tl.where(both, here - tile(table, begin + there, rank, RANK, both), 0.0)
    at = to + offset((begin + n)[:, None], RANK, rank[None, :])
    tl.store(at, tl.load(at, mask=valid, other=0.0) + strength * total, mask=valid)
