"""Compositing, one lane per ray (kernels/cpu/compositing.py), and the photometric losses."""

import triton
import triton.language as tl

from stylerf.kernels.cpu import compositing
from stylerf.kernels.gpu.indexing import offset, store_vector, vector

SURFACE_REACH = tl.constexpr(float(compositing.SURFACE_REACH))


@triton.jit
def rays_of_program(starts, ends, rays, BLOCK: tl.constexpr):
    """(rays, whether they exist, their first samples, their numbers of samples)."""
    r = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    valid = r < rays
    first = tl.load(starts + r, mask=valid, other=0)
    return r, valid, first, tl.load(ends + r, mask=valid, other=0) - first


@triton.jit(do_not_specialize=["rays"])
def composite_kernel(weights, deltas, colors, t, starts, ends, out, rays, BLOCK: tl.constexpr):
    """out[r] = (sum w c (3), sum w, sum w t); samples without a color (colors[k, 0] < 0) get the mean of the others.

    The opaque background (delta 0) is excluded from sum w t.
    """
    r, valid, first, count = rays_of_program(starts, ends, rays, BLOCK)
    zero = first.to(tl.float32) * 0.0
    # All lanes march as far as the program's longest ray; those whose ray has ended load zeros.
    red, green, blue, depth, total, colored = zero, zero, zero, zero, zero, zero
    for i in range(0, tl.max(count, axis=0)):
        own = i < count
        k = first + i
        w = tl.load(weights + k, mask=own, other=0.0)
        c0 = tl.load(colors + offset(k, 3, 0), mask=own, other=-1.0)
        _c0, c1, c2 = vector(colors, k, own & (c0 >= 0.0))
        total += w
        held = own & (tl.load(deltas + k, mask=own, other=0.0) > 0.0)
        depth += w * tl.load(t + k, mask=held, other=0.0)
        shown = tl.where(c0 >= 0.0, w, 0.0)
        colored += shown
        red += shown * c0
        green += shown * c1
        blue += shown * c2
    scale = tl.where(colored > 0.0, total / tl.where(colored > 0.0, colored, 1.0), 0.0)
    at = offset(r, 5, 0)
    tl.store(out + at, red * scale, mask=valid)
    tl.store(out + at + 1, green * scale, mask=valid)
    tl.store(out + at + 2, blue * scale, mask=valid)
    tl.store(out + at + 3, total, mask=valid)
    tl.store(out + at + 4, depth, mask=valid)


@triton.jit(do_not_specialize=["rays"])
def surface_distance_kernel(weights, t, starts, ends, out, rays, BLOCK: tl.constexpr):
    """out[r] = distance of the surface visible along ray r; see surface_distance in kernels/cpu/compositing.py."""
    r, valid, first, count = rays_of_program(starts, ends, rays, BLOCK)
    zero = first.to(tl.float32) * 0.0
    longest = tl.max(count, axis=0)
    # Three passes: the sum of weights, where half of it is reached, the mean around there (decision 0032).
    total, passed, at, near, depth = zero, zero, zero, zero, zero
    for i in range(0, longest):
        total += tl.load(weights + first + i, mask=i < count, other=0.0)
    for i in range(0, longest):
        own = i < count
        w = tl.load(weights + first + i, mask=own, other=0.0)
        here = own & (passed < total * 0.5) & (passed + w >= total * 0.5)
        at = tl.where(here, tl.load(t + first + i, mask=own, other=0.0), at)
        passed += w
    for i in range(0, longest):
        own = i < count
        there = tl.load(t + first + i, mask=own, other=0.0)
        w = tl.load(weights + first + i, mask=own & (tl.abs(there - at) <= at * SURFACE_REACH), other=0.0)
        near += w
        depth += w * there
    tl.store(out + r, tl.where(near > 0.0, depth / tl.where(near > 0.0, near, 1.0), 0.0), mask=valid)


@triton.jit(do_not_specialize=["rays"])
def composite_backward_kernel(
    weights, deltas, colors, t, starts, ends, out, gradients, near_scaling_distance, sigma_gradients,
    color_gradients, rays,
    BLOCK: tl.constexpr,
):  # fmt: skip
    """dL/d(sigma) [n] and dL/d(color) [n, 3] from dL/d(out) [rays, 5]; see composite_backward on the CPU.

    near_scaling_distance: gradients of nearer samples are scaled by (t / distance)^2 (scale_near_gradients); 0: none.
    """
    r, valid, first, count = rays_of_program(starts, ends, rays, BLOCK)
    at = offset(r, 5, 0)
    g0 = tl.load(gradients + at, mask=valid, other=0.0)
    g1 = tl.load(gradients + at + 1, mask=valid, other=0.0)
    g2 = tl.load(gradients + at + 2, mask=valid, other=0.0)
    ga = tl.load(gradients + at + 3, mask=valid, other=0.0)
    gd = tl.load(gradients + at + 4, mask=valid, other=0.0)
    total = tl.load(out + at + 3, mask=valid, other=0.0)
    mean = g0 * tl.load(out + at, mask=valid, other=0.0)
    mean += g1 * tl.load(out + at + 1, mask=valid, other=0.0)
    mean += g2 * tl.load(out + at + 2, mask=valid, other=0.0)
    mean = tl.where(total > 0.0, mean / tl.where(total > 0.0, total, 1.0), 0.0)
    # Two passes, as on the CPU, but the second computes D_k again: a lane cannot keep those of a whole ray.
    behind = 0.0 * total
    longest = tl.max(count, axis=0)
    for i in range(0, longest):
        own = i < count
        k = first + i
        w = tl.load(weights + k, mask=own, other=0.0)
        c0 = tl.load(colors + offset(k, 3, 0), mask=own, other=-1.0)
        shown = own & (c0 >= 0.0)
        c0, c1, c2 = vector(colors, k, shown)
        held = own & (tl.load(deltas + k, mask=own, other=0.0) > 0.0)
        d = ga + gd * tl.load(t + k, mask=held, other=0.0)
        d += tl.where(shown, g0 * c0 + g1 * c1 + g2 * c2, mean)
        behind += tl.where(own, w * d, 0.0)
    transmittance = 1.0 + 0.0 * total
    for i in range(0, longest):
        own = i < count
        k = first + i
        w = tl.load(weights + k, mask=own, other=0.0)
        c0 = tl.load(colors + offset(k, 3, 0), mask=own, other=-1.0)
        shown = own & (c0 >= 0.0)
        c0, c1, c2 = vector(colors, k, shown)
        far = tl.load(t + k, mask=own, other=0.0)
        length = tl.load(deltas + k, mask=own, other=0.0)
        d = ga + tl.where(length > 0.0, gd * far, 0.0)
        d += tl.where(shown, g0 * c0 + g1 * c1 + g2 * c2, mean)
        behind -= tl.where(own, w * d, 0.0)
        transmittance -= w
        # With a distance of 0 no sample is nearer, and none is scaled.
        near = far / tl.maximum(near_scaling_distance, 1e-9)
        even = tl.where(far < near_scaling_distance, near * near, 1.0)
        s = length * (transmittance * d - behind)
        tl.store(sigma_gradients + k, s * even, mask=own)
        # Left undefined where there is no color: to_learn() does not read them there.
        store_vector(color_gradients, k, w * g0 * even, w * g1 * even, w * g2 * even, shown)


@triton.jit(do_not_specialize=["rays"])
def distortion_backward_kernel(
    weights, deltas, t, starts, ends, strength, middle, sigma_gradients, rays, BLOCK: tl.constexpr
):
    """Add dL/d(sigma) of each ray's distortion loss; see distortion_backward on the CPU."""
    _r, _valid, first, count = rays_of_program(starts, ends, rays, BLOCK)
    zero = first.to(tl.float32) * 0.0
    longest = tl.max(count, axis=0)
    total, moment = zero, zero
    for i in range(0, longest):
        own = i < count
        w = tl.load(weights + first + i, mask=own, other=0.0)
        far = tl.load(t + first + i, mask=own, other=0.0)
        total += w
        moment += w * (far / (far + middle))
    behind, before, moment_before = zero, zero, zero
    for i in range(0, longest):
        own = i < count
        w = tl.load(weights + first + i, mask=own, other=0.0)
        far = tl.load(t + first + i, mask=own, other=0.0)
        s = far / (far + middle)
        before += w
        moment_before += w * s
        behind += w * (s * (2.0 * before - w - total) - (2.0 * moment_before - w * s - moment))
    transmittance, before, moment_before = zero + 1.0, zero, zero
    for i in range(0, longest):
        own = i < count
        k = first + i
        w = tl.load(weights + k, mask=own, other=0.0)
        far = tl.load(t + k, mask=own, other=0.0)
        s = far / (far + middle)
        before += w
        moment_before += w * s
        d = s * (2.0 * before - w - total) - (2.0 * moment_before - w * s - moment)
        behind -= w * d
        transmittance -= w
        length = tl.load(deltas + k, mask=own, other=0.0)
        old = tl.load(sigma_gradients + k, mask=own, other=0.0)
        tl.store(sigma_gradients + k, old + 2.0 * strength * length * (transmittance * d - behind), mask=own)


@triton.jit(do_not_specialize=["rays"])
def loss_kernel(out, wanted, background, counts, starts, ends, scale, gradients, sums, rays, BLOCK: tl.constexpr):
    """dL/d(out) [rays, 5] of the squared error against straight rgba [rays, 4], both over a background [rays, 3].

    scale: 2 / (3 rays of the whole batch). sums += squared error, samples, rays that do not fit (which have no gradient
    and no error).
    """
    r, valid, _first, held = rays_of_program(starts, ends, rays, BLOCK)
    lost = valid & (tl.load(counts + r, mask=valid, other=0) != held)
    own = valid & (lost == 0)
    alpha = tl.load(out + offset(r, 5, 3), mask=own, other=0.0)
    cover = tl.load(wanted + offset(r, 4, 3), mask=own, other=0.0)
    error = 0.0 * alpha
    of_alpha = 0.0 * alpha
    for a in tl.static_range(3):
        back = tl.load(background + offset(r, 3, a), mask=own, other=0.0)
        found = tl.load(out + offset(r, 5, a), mask=own, other=0.0) + (1.0 - alpha) * back
        difference = found - tl.load(wanted + offset(r, 4, a), mask=own, other=0.0) * cover - (1.0 - cover) * back
        error += tl.where(own, difference * difference, 0.0)
        g = difference * scale
        # d(out + (1 - alpha) back)/d(alpha) = -back
        of_alpha -= g * back
        tl.store(gradients + offset(r, 5, a), tl.where(own, g, 0.0), mask=valid)
    tl.store(gradients + offset(r, 5, 3), tl.where(own, of_alpha, 0.0), mask=valid)
    tl.store(gradients + offset(r, 5, 4), 0.0, mask=valid)
    tl.atomic_add(sums, tl.sum(error, axis=0), sem="relaxed")
    tl.atomic_add(sums + 1, tl.sum(held.to(tl.float32), axis=0), sem="relaxed")
    tl.atomic_add(sums + 2, tl.sum(lost.to(tl.float32), axis=0), sem="relaxed")


@triton.jit(do_not_specialize=["rays", "edited"])
def tuning_loss_kernel(
    out, wanted, depth, counts, starts, ends, level, scale, depth_scale, edited, gradients, sums, rays,
    BLOCK: tl.constexpr,
):  # fmt: skip
    """dL/d(out) [rays, 5] for fine-tuning: squared error against straight rgba [rays, 4] over gray `level`, times
    scale / 2, and at the first `edited` rays (sum w t / depth - 1)^2, times depth_scale / 2, unless the depth is 0.

    sums += squared error at the other rays, at edited ones, of depths; number of rays of either kind that do not fit.
    """
    r, valid, _first, held = rays_of_program(starts, ends, rays, BLOCK)
    lost = valid & (tl.load(counts + r, mask=valid, other=0) != held)
    own = valid & (lost == 0)
    inside = r < edited
    alpha = tl.load(out + offset(r, 5, 3), mask=own, other=0.0)
    cover = tl.load(wanted + offset(r, 4, 3), mask=own, other=0.0)
    error = 0.0 * alpha
    of_alpha = 0.0 * alpha
    for a in tl.static_range(3):
        found = tl.load(out + offset(r, 5, a), mask=own, other=0.0) + (1.0 - alpha) * level
        target = tl.load(wanted + offset(r, 4, a), mask=own, other=0.0) * cover + (1.0 - cover) * level
        difference = tl.where(own, found - target, 0.0)
        error += difference * difference
        of_alpha -= difference * scale * level
        tl.store(gradients + offset(r, 5, a), difference * scale, mask=valid)
    tl.store(gradients + offset(r, 5, 3), of_alpha, mask=valid)
    wanted_depth = tl.load(depth + r, mask=own & inside, other=0.0)
    known = tl.maximum(wanted_depth, 1e-6)
    off = tl.load(out + offset(r, 5, 4), mask=own & inside, other=0.0) / known - 1.0
    off = tl.where((wanted_depth > 0.0) & (depth_scale > 0.0), off, 0.0)
    tl.store(gradients + offset(r, 5, 4), depth_scale * off / known, mask=valid)
    tl.atomic_add(sums, tl.sum(tl.where(inside, 0.0, error), axis=0), sem="relaxed")
    tl.atomic_add(sums + 1, tl.sum(tl.where(inside, error, 0.0), axis=0), sem="relaxed")
    tl.atomic_add(sums + 2, tl.sum(off * off, axis=0), sem="relaxed")
    tl.atomic_add(sums + 3, tl.sum((lost & (inside == 0)).to(tl.float32), axis=0), sem="relaxed")
    tl.atomic_add(sums + 4, tl.sum((lost & inside).to(tl.float32), axis=0), sem="relaxed")


@triton.jit(do_not_specialize=["count"])
def shade_backward_kernel(weights, gradients, ray_of, color_gradients, count, BLOCK: tl.constexpr):
    """dL/dc_k = w_k dL/d(out_r) for `count` samples; gradients [rays, 3]."""
    k = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    valid = k < count
    a, b, c = vector(gradients, tl.load(ray_of + k, mask=valid, other=0), valid)
    w = tl.load(weights + k, mask=valid, other=0.0)
    store_vector(color_gradients, k, w * a, w * b, w * c, valid)
