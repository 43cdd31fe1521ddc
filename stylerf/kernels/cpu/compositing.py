"""composite: samples' colors and weights to pixels, and back (Max 1995; Mildenhall et al. 2020, eq. 3)."""

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import parallel_kernel

_ONE, _ZERO, _HALF = np.float32(1), np.float32(0), np.float32(0.5)
AROUND = np.float32(0.05)  # of its distance: samples so close to a ray's middle one are of the same surface


@parallel_kernel
def composite(weights, optical, colors, t, starts, ends, chunks, out):
    """out[r] = (sum w c (3), sum w, sum w t). Samples without a color (colors[k, 0] < 0) take the mean of the others.

    They weigh next to nothing; counting them as black would pull every density the wrong way. A backdrop (optical[k]
    0) has no part in sum w t: so far out, the least of light that reaches it would be all that counts.
    """
    n = len(ends)
    for c in prange(chunks):
        for r in range(c * n // chunks, (c + 1) * n // chunks):
            red, green, blue, depth = _ZERO, _ZERO, _ZERO, _ZERO
            total, colored = _ZERO, _ZERO
            for k in range(starts[r], ends[r]):
                w = weights[k]
                total += w
                if optical[k] > _ZERO:
                    depth += w * t[k]
                if colors[k, 0] >= _ZERO:
                    colored += w
                    red += w * colors[k, 0]
                    green += w * colors[k, 1]
                    blue += w * colors[k, 2]
            scale = total / colored if colored > _ZERO else _ZERO
            out[r, 0] = red * scale
            out[r, 1] = green * scale
            out[r, 2] = blue * scale
            out[r, 3] = total
            out[r, 4] = depth


@parallel_kernel
def surface_distance(weights, t, starts, ends, chunks, out):
    """out[r, 4] = distance of what ray r shows, from out[r, 3] = sum w; 0 for a ray without weight.

    It is found where half of the weight lies, as the mean of w t over the samples within AROUND of there. What lies
    before or behind, be it a haze, another surface or the backdrop, does not move it.
    """
    n = len(ends)
    for c in prange(chunks):
        for r in range(c * n // chunks, (c + 1) * n // chunks):
            half, passed, middle = out[r, 3] * _HALF, _ZERO, ends[r]
            for k in range(starts[r], ends[r]):
                passed += weights[k]
                if passed >= half:
                    middle = k
                    break
            near, depth = _ZERO, _ZERO
            if middle < ends[r]:
                reach = AROUND * t[middle]
                first = middle
                while first > starts[r] and t[middle] - t[first - 1] <= reach:
                    first -= 1
                for k in range(first, ends[r]):
                    if t[k] - t[middle] > reach:
                        break
                    near += weights[k]
                    depth += weights[k] * t[k]
            out[r, 4] = depth / near if near > _ZERO else _ZERO


@parallel_kernel
def composite_backward(
    sigma, weights, optical, colors, t, starts, ends, out, gradients, chunks, sigma_gradients, color_gradients
):
    """From dL/d(out) [rays, 5] to dL/d(sigma) [n] and dL/d(color) [n, 3].

    dL/d(sigma_k) = optical_k (T_{k+1} D_k - sum_{i>k} w_i D_i) with D_k = dL/dw_k, T_{k+1} the transmittance behind k.
    The scale that spreads the color over uncolored samples is treated as a constant.
    """
    n = len(ends)
    for c in prange(chunks):
        for r in range(c * n // chunks, (c + 1) * n // chunks):
            g0, g1, g2 = gradients[r, 0], gradients[r, 1], gradients[r, 2]
            ga, gd = gradients[r, 3], gradients[r, 4]
            total = out[r, 3]
            mean = (g0 * out[r, 0] + g1 * out[r, 1] + g2 * out[r, 2]) / total if total > _ZERO else _ZERO
            behind = _ZERO
            for k in range(starts[r], ends[r]):
                w = weights[k]
                d = ga + gd * t[k] if optical[k] > _ZERO else ga
                if colors[k, 0] >= _ZERO:
                    d += g0 * colors[k, 0] + g1 * colors[k, 1] + g2 * colors[k, 2]
                    color_gradients[k, 0] = w * g0
                    color_gradients[k, 1] = w * g1
                    color_gradients[k, 2] = w * g2
                else:
                    d += mean
                sigma_gradients[k] = d
                behind += w * d
            through = _ONE
            for k in range(starts[r], ends[r]):
                d = sigma_gradients[k]
                behind -= weights[k] * d
                through -= weights[k]
                sigma_gradients[k] = optical[k] * (through * d - behind)


@parallel_kernel
def scale_near(t, starts, ends, distance, chunks, sigma_gradients, color_gradients):
    """Gradients of samples nearer than `distance` times (t / distance)^2 (Philip, Deschaintre 2023).

    A camera's rays are that much denser there, and a step would otherwise teach what is close to it first of all.
    """
    n = len(ends)
    for c in prange(chunks):
        for r in range(c * n // chunks, (c + 1) * n // chunks):
            for k in range(starts[r], ends[r]):
                if t[k] < distance:
                    share = (t[k] / distance) * (t[k] / distance)
                    sigma_gradients[k] *= share
                    for a in range(3):
                        color_gradients[k, a] *= share


@parallel_kernel
def significant(weights, starts, ends, share, chunks, shown):
    """shown[k] = weights[k] where it is at least `share` of its ray's largest weight, else 0: never a whole ray."""
    n = len(ends)
    for c in prange(chunks):
        for r in range(c * n // chunks, (c + 1) * n // chunks):
            largest = _ZERO
            for k in range(starts[r], ends[r]):
                largest = max(largest, weights[k])
            bound = largest * share
            for k in range(starts[r], ends[r]):
                shown[k] = weights[k] if weights[k] >= bound else _ZERO


@parallel_kernel
def count_shown(shown, starts, ends, chunks, counts):
    """counts[r] = samples of ray r with shown > 0."""
    n = len(ends)
    for c in prange(chunks):
        for r in range(c * n // chunks, (c + 1) * n // chunks):
            found = 0
            for k in range(starts[r], ends[r]):
                if shown[k] > _ZERO:
                    found += 1
            counts[r] = found


@parallel_kernel
def pack_shown(shown, x, weights, starts, ends, offsets, chunks, packed_x, packed_w):
    """Keep the shown samples: x as 16-bit cube positions, weights scaled so that each ray keeps its alpha."""
    n = len(ends)
    for c in prange(chunks):
        for r in range(c * n // chunks, (c + 1) * n // chunks):
            total, kept = _ZERO, _ZERO
            for k in range(starts[r], ends[r]):
                total += weights[k]
                kept += shown[k]
            scale = total / kept if kept > _ZERO else _ZERO
            at = offsets[r]
            for k in range(starts[r], ends[r]):
                if shown[k] > _ZERO:
                    for a in range(3):
                        packed_x[at, a] = np.uint16(x[k, a] * np.float32(65535) + np.float32(0.5))
                    packed_w[at] = shown[k] * scale
                    at += 1


@parallel_kernel
def unpack(pixels, offsets, packed_x, packed_w, starts, x, weights):
    """Samples of chosen pixels of a packed view, from starts[r] on."""
    for r in prange(len(pixels)):
        at = starts[r]
        for k in range(offsets[pixels[r]], offsets[pixels[r] + 1]):
            for a in range(3):
                x[at, a] = np.float32(packed_x[k, a]) * np.float32(1 / 65535)
            weights[at] = packed_w[k]
            at += 1


@parallel_kernel
def shade(weights, colors, starts, ends, out):
    """out[r] = sum w c over the ray's samples, [rays, 3]."""
    for r in prange(len(ends)):
        red, green, blue = _ZERO, _ZERO, _ZERO
        for k in range(starts[r], ends[r]):
            red += weights[k] * colors[k, 0]
            green += weights[k] * colors[k, 1]
            blue += weights[k] * colors[k, 2]
        out[r, 0], out[r, 1], out[r, 2] = red, green, blue


@parallel_kernel
def shade_backward(weights, gradients, starts, ends, color_gradients):
    """dL/dc_k = w_k dL/d(out_r)."""
    for r in prange(len(ends)):
        for k in range(starts[r], ends[r]):
            for a in range(3):
                color_gradients[k, a] = weights[k] * gradients[r, a]
