"""Shared by the color kernels: which samples get a color, which get gradients, and the directions' harmonics."""

import triton
import triton.language as tl

from stylerf.kernels.gpu.indexing import offset, vector


@triton.jit
def to_color(k, count, ray_of, weights, largest, weight_threshold):
    """(inside, valid, ray): which samples exist, which reach the weight threshold, their rays."""
    inside = k < count
    ray = tl.load(ray_of + k, mask=inside, other=0)
    w = tl.load(weights + k, mask=inside, other=0.0)
    # w > 0: on a ray without any weight every sample reaches the threshold, which is 0.
    return inside, inside & (w > 0.0) & (w >= weight_threshold * tl.load(largest + ray, mask=inside, other=0.0)), ray


@triton.jit
def to_learn(k, inside, colors, color_gradients):
    """(valid, g0, g1, g2): which samples have a color, and dL/d(logits) of its channels, zero without a color."""
    valid = tl.load(colors + offset(k, 3, 0), mask=inside, other=-1.0) >= 0.0
    c0, c1, c2 = vector(colors, k, valid)
    g0, g1, g2 = vector(color_gradients, k, valid)
    return valid, g0 * c0 * (1.0 - c0), g1 * c1 * (1.0 - c1), g2 * c2 * (1.0 - c2)


@triton.jit
def sigmoid(z):
    return 1.0 / (1.0 + tl.exp(-z))


@triton.jit
def bands_of(dx, dy, dz, output, BANDS: tl.constexpr):
    """[samples, outputs]: the spherical harmonic of each output's band (output % BANDS) in each direction; see
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


@triton.jit
def sum_of_channel(values, output, BANDS: tl.constexpr, j: tl.constexpr):
    """Sum of the columns of [samples, OUTPUTS] that belong to channel j."""
    own = (output >= j * BANDS) & (output < (j + 1) * BANDS)
    return tl.sum(tl.where(own[None, :], values, 0.0), axis=1)


@triton.jit
def of_channel(output, g0, g1, g2, BANDS: tl.constexpr):
    """[samples, columns]: the gradient of each column's channel; zero beyond 3 BANDS columns."""
    channel = (output // BANDS)[None, :]
    own = tl.where(channel == 0, g0[:, None], tl.where(channel == 1, g1[:, None], g2[:, None]))
    return tl.where(output[None, :] < 3 * BANDS, own, 0.0)
