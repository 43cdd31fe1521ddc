"""Composite samples' colors and weights to pixels, and the backward pass (Max 1995; Mildenhall et al. 2020, eq. 3)."""

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import parallel_kernel

_ONE, _ZERO, _HALF, _TWO = np.float32(1), np.float32(0), np.float32(0.5), np.float32(2)
SURFACE_REACH = np.float32(0.05)  # assumed half thickness of a surface, relative to its distance


@parallel_kernel
def composite(samples, colors, threads, out):
    """Composite samples to out[r] = (sum w c (3), sum w, sum w t).

    Samples without a color (colors[k, 0] < 0) get the ray's mean color: they have hardly any weight, but black would
    bias every density's gradient. The opaque background (delta 0) is excluded from sum w t: it is so far away that even
    a tiny weight would dominate.
    """
    starts, ends, t, deltas, weights = samples.starts, samples.ends, samples.t, samples.deltas, samples.weights
    n = len(ends)
    for thread in prange(threads):
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            red, green, blue, depth = _ZERO, _ZERO, _ZERO, _ZERO
            total, colored = _ZERO, _ZERO
            for k in range(starts[r], ends[r]):
                w = weights[k]
                total += w
                if deltas[k] > _ZERO:
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
def keep_shared(weights, shares, starts, ends, threads, out):
    """out[k] = weights[k] where shares[k] > 0, else 0: the samples that a layer of a blend must color."""
    n = len(ends)
    for thread in prange(threads):
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            for k in range(starts[r], ends[r]):
                out[k] = weights[k] if shares[k] > _ZERO else _ZERO


@parallel_kernel
def composite_share(samples, visible, colors, shares, threads, out):
    """Composite a layer of a blend to out[r] = (sum w s c (3), sum w s, sum w t), s = shares[k] in 0..1.

    Samples that are not visible (visible[k] = 0) get the ray's mean of s c and of s. With s = 1 everywhere, the result
    is bit-identical to that of composite().
    """
    starts, ends, t, deltas, weights = samples.starts, samples.ends, samples.t, samples.deltas, samples.weights
    n = len(ends)
    for thread in prange(threads):
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            red, green, blue, depth = _ZERO, _ZERO, _ZERO, _ZERO
            total, seen, own = _ZERO, _ZERO, _ZERO
            for k in range(starts[r], ends[r]):
                total += weights[k]
                if deltas[k] > _ZERO:
                    depth += weights[k] * t[k]
                if visible[k] > _ZERO:
                    seen += weights[k]
                    if shares[k] > _ZERO:
                        w = weights[k] * shares[k]
                        own += w
                        red += w * colors[k, 0]
                        green += w * colors[k, 1]
                        blue += w * colors[k, 2]
            scale = total / seen if seen > _ZERO else _ZERO
            out[r, 0] = red * scale
            out[r, 1] = green * scale
            out[r, 2] = blue * scale
            # own / seen is exactly 1 where this is the only layer.
            out[r, 3] = total * (own / seen) if seen > _ZERO else _ZERO
            out[r, 4] = depth


@parallel_kernel
def surface_distance(samples, threads, out):
    """Set out[r, 4] to the distance of the surface visible along ray r, given out[r, 3] = sum w; 0 without weight.

    The surface is where the cumulative weight passes one half of the total; its distance is the weighted mean of t over
    the samples within SURFACE_REACH of that point. Haze in front, a second surface or the background behind do not
    affect it (decision 0032).
    """
    starts, ends, t, weights = samples.starts, samples.ends, samples.t, samples.weights
    n = len(ends)
    for thread in prange(threads):
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            half, passed, middle = out[r, 3] * _HALF, _ZERO, ends[r]  # ends[r]: no sample
            for k in range(starts[r], ends[r]):
                passed += weights[k]
                if passed >= half:
                    middle = k
                    break
            near, depth = _ZERO, _ZERO
            if middle < ends[r]:
                reach = SURFACE_REACH * t[middle]
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
def composite_backward(samples, colors, out, gradients, threads, sigma_gradients, color_gradients):
    """Compute dL/d(sigma) [n] and dL/d(color) [n, 3] from dL/d(out) [rays, 5].

    With D_k = dL/dw_k and T_{k+1} the transmittance behind sample k:

        dL/d(sigma_k) = delta_k (T_{k+1} D_k - sum_{i>k} w_i D_i)

    The mean color of uncolored samples is treated as a constant.
    """
    # From w_k = T_k (1 - exp(-sigma_k delta_k)): dw_k/dsigma_k = delta_k T_{k+1}, and dw_i/dsigma_k = -delta_k w_i for
    # i > k. The first pass sums all w_i D_i; the second, front to back, subtracts the terms up to sample k.
    starts, ends, t, deltas, weights = samples.starts, samples.ends, samples.t, samples.deltas, samples.weights
    n = len(ends)
    for thread in prange(threads):
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            g0, g1, g2 = gradients[r, 0], gradients[r, 1], gradients[r, 2]
            ga, gd = gradients[r, 3], gradients[r, 4]
            total = out[r, 3]
            # g . c for samples with the mean color, which is out[0:3] / alpha.
            mean = (g0 * out[r, 0] + g1 * out[r, 1] + g2 * out[r, 2]) / total if total > _ZERO else _ZERO
            behind = _ZERO
            for k in range(starts[r], ends[r]):
                w = weights[k]
                d = ga + gd * t[k] if deltas[k] > _ZERO else ga
                if colors[k, 0] >= _ZERO:
                    d += g0 * colors[k, 0] + g1 * colors[k, 1] + g2 * colors[k, 2]
                    color_gradients[k, 0] = w * g0
                    color_gradients[k, 1] = w * g1
                    color_gradients[k, 2] = w * g2
                else:
                    d += mean
                sigma_gradients[k] = d  # D_k, until the second pass
                behind += w * d
            transmittance = _ONE
            for k in range(starts[r], ends[r]):
                d = sigma_gradients[k]
                behind -= weights[k] * d
                transmittance -= weights[k]  # T_{k+1} = 1 - w_0 - ... - w_k
                sigma_gradients[k] = deltas[k] * (transmittance * d - behind)


@parallel_kernel
def distortion_backward(samples, strength, middle, threads, sigma_gradients):
    """Add dL/d(sigma) of each ray's distortion loss (Barron et al. 2022, eq. 15, without the per-interval term):

        L = strength sum_ij w_i w_j |s_i - s_j|,    s = t / (t + middle)

    dL/dw_k = 2 strength (s_k (W< - W>) - (S< - S>)), with W and S the sums of w and of w s in front of k and behind it.
    The opaque background is included: haze in front of it is as far from it as from any surface.
    """
    starts, ends, t, deltas, weights = samples.starts, samples.ends, samples.t, samples.deltas, samples.weights
    n = len(ends)
    for thread in prange(threads):
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            total, moment = _ZERO, _ZERO
            for k in range(starts[r], ends[r]):
                total += weights[k]
                moment += weights[k] * (t[k] / (t[k] + middle))
            # As in composite_backward: first sum_i w_i D_i, then the part of it behind each sample.
            behind, before, moment_before = _ZERO, _ZERO, _ZERO
            for k in range(starts[r], ends[r]):
                w, s = weights[k], t[k] / (t[k] + middle)
                before += w
                moment_before += w * s
                behind += w * (s * (_TWO * before - w - total) - (_TWO * moment_before - w * s - moment))
            transmittance, before, moment_before = _ONE, _ZERO, _ZERO
            for k in range(starts[r], ends[r]):
                w, s = weights[k], t[k] / (t[k] + middle)
                before += w
                moment_before += w * s
                d = s * (_TWO * before - w - total) - (_TWO * moment_before - w * s - moment)
                behind -= w * d
                transmittance -= w
                sigma_gradients[k] += _TWO * strength * deltas[k] * (transmittance * d - behind)


@parallel_kernel
def scale_near_gradients(samples, distance, threads, sigma_gradients, color_gradients):
    """Scale the gradients of samples nearer than `distance` by (t / distance)^2 (Philip and Deschaintre 2023).

    A camera's rays are that much denser there: without scaling, floaters near a camera would learn fastest.
    """
    starts, ends, t = samples.starts, samples.ends, samples.t
    n = len(ends)
    for thread in prange(threads):
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            for k in range(starts[r], ends[r]):
                if t[k] < distance:
                    scale = (t[k] / distance) * (t[k] / distance)
                    sigma_gradients[k] *= scale
                    for a in range(3):
                        color_gradients[k, a] *= scale


@parallel_kernel
def visible_weights(samples, weight_threshold, threads, visible):
    """visible[k] = weights[k] where it is at least `weight_threshold` times its ray's largest weight, else 0.

    The threshold is relative, so that no ray ends up without a visible sample.
    """
    starts, ends, weights = samples.starts, samples.ends, samples.weights
    n = len(ends)
    for thread in prange(threads):
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            largest = _ZERO
            for k in range(starts[r], ends[r]):
                largest = max(largest, weights[k])
            bound = largest * weight_threshold
            for k in range(starts[r], ends[r]):
                visible[k] = weights[k] if weights[k] >= bound else _ZERO


@parallel_kernel
def pack_visible(visible, samples, offsets, threads, packed_x, packed_weights):
    """Pack the visible samples: x as 16-bit cube positions, weights scaled so that each ray keeps its alpha."""
    starts, ends, x, weights = samples.starts, samples.ends, samples.x, samples.weights
    n = len(ends)
    for thread in prange(threads):
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            total, kept = _ZERO, _ZERO
            for k in range(starts[r], ends[r]):
                total += weights[k]
                kept += visible[k]
            scale = total / kept if kept > _ZERO else _ZERO
            at = offsets[r]
            for k in range(starts[r], ends[r]):
                if visible[k] > _ZERO:
                    for a in range(3):
                        # Round to nearest: the conversion truncates.
                        packed_x[at, a] = np.uint16(x[k, a] * np.float32(65535) + np.float32(0.5))
                    packed_weights[at] = visible[k] * scale
                    at += 1


@parallel_kernel
def unpack(pixels, offsets, packed_x, packed_weights, starts, x, weights):
    """Unpack the samples of the given pixels of a packed view; those of pixel r are written from starts[r] on."""
    for r in prange(len(pixels)):
        at = starts[r]
        for k in range(offsets[pixels[r]], offsets[pixels[r] + 1]):
            for a in range(3):
                x[at, a] = np.float32(packed_x[k, a]) * np.float32(1 / 65535)
            weights[at] = packed_weights[k]
            at += 1


@parallel_kernel
def shade(points, colors, out):
    """out[r] = sum w c over the ray's points, [rays, 3]."""
    starts, ends, weights = points.starts, points.ends, points.weights
    for r in prange(len(ends)):
        red, green, blue = _ZERO, _ZERO, _ZERO
        for k in range(starts[r], ends[r]):
            red += weights[k] * colors[k, 0]
            green += weights[k] * colors[k, 1]
            blue += weights[k] * colors[k, 2]
        out[r, 0], out[r, 1], out[r, 2] = red, green, blue


@parallel_kernel
def shade_backward(points, gradients, color_gradients):
    """dL/dc_k = w_k dL/d(out_r)."""
    starts, ends, weights = points.starts, points.ends, points.weights
    for r in prange(len(ends)):
        for k in range(starts[r], ends[r]):
            for a in range(3):
                color_gradients[k, a] = weights[k] * gradients[r, a]
