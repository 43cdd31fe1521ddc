"""Real spherical harmonics up to degree 2 of ray directions, aligned with the outputs of a color head."""

import triton
import triton.language as tl


@triton.jit
def bands_of(dx, dy, dz, output, BANDS: tl.constexpr):
    """[samples, outputs]: the harmonic of output's band (output % BANDS) in each direction;
    geometry/spherical_harmonics.py."""
    band = (output % BANDS)[None, :]
    x, y, z = dx[:, None], dy[:, None], dz[:, None]
    values = tl.where(band == 0, 0.28209479177387814, x * 0.0)
    if BANDS > 1:
        values = tl.where(band == 1, -0.4886025119029199 * y, values)
        values = tl.where(band == 2, 0.4886025119029199 * z, values)
        values = tl.where(band == 3, -0.4886025119029199 * x, values)
    if BANDS > 4:
        values = tl.where(band == 4, 1.0925484305920792 * x * y, values)
        values = tl.where(band == 5, -1.0925484305920792 * y * z, values)
        values = tl.where(band == 6, 0.31539156525252005 * (3.0 * z * z - 1.0), values)
        values = tl.where(band == 7, -1.0925484305920792 * x * z, values)
        values = tl.where(band == 8, 0.5462742152960396 * (x * x - y * y), values)
    return values
