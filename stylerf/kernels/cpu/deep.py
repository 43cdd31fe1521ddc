"""Merge the samples of each ray into a few segments, for deep images."""

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import parallel_kernel
from stylerf.kernels.cpu.march import warp_at

_ZERO, _HALF = np.float32(0), np.float32(0.5)


@parallel_kernel
def segments(samples, colors, rays, space, step, most, samples_per_ray, threads, counts, out):
    """Merge the colored samples of each ray into at most `most` segments, front to back.

    Greedily merges the neighbors i and j along the ray with the lowest cost:

        w_i w_j / (w_i + w_j) |t_j - t_i|        (Ward 1963, in one dimension and with absolute distances)

    A sample extends half a step to both sides; the opaque background (delta 0) is a point. Weights are scaled to keep
    a ray's alpha, as in composite().

    Args:
        samples, colors, rays: As marched and composited; colors[k, 0] < 0: no color.
        space: Space; with step, the cube units per sample, it gives a sample's length along the ray.
        counts: output, [rays] int64.
        out: output, [rays, most, 6] float32: begin and end (distance along the ray, scene units), premultiplied red,
            green, blue (sRGB-encoded), weight.
    """
    starts, ends, t, deltas, weights = samples.starts, samples.ends, samples.t, samples.deltas, samples.weights
    origins, directions = rays.origins, rays.directions
    n = len(ends)
    for thread in prange(threads):
        row = np.empty((samples_per_ray, 7), np.float32)  # the six of `out`, and the weighted mean of t
        q = np.empty(3, np.float32)
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            held = 0
            total, colored, last = _ZERO, _ZERO, _ZERO
            for k in range(starts[r], ends[r]):
                w = weights[k]
                total += w
                if colors[k, 0] < _ZERO or w <= _ZERO:
                    continue
                colored += w
                reach = _ZERO
                if deltas[k] > _ZERO:
                    dx, dy, dz = directions[r, 0], directions[r, 1], directions[r, 2]
                    px, py, pz = origins[r, 0] + t[k] * dx, origins[r, 1] + t[k] * dy, origins[r, 2] + t[k] * dz
                    speed, _ = warp_at(space, px, py, pz, dx, dy, dz, q)
                    reach = _HALF * step / speed
                # Where steps grow along the ray, neighbors overlap.
                row[held, 0] = min(max(t[k] - reach, last), t[k])
                row[held, 1] = t[k] + reach
                for a in range(3):
                    row[held, 2 + a] = w * colors[k, a]
                row[held, 5] = w
                row[held, 6] = t[k]
                last = row[held, 1]
                held += 1
            while held > most:
                best, cheapest = 0, np.float32(np.inf)
                for i in range(held - 1):
                    w, v = row[i, 5], row[i + 1, 5]
                    cost = w * v / (w + v) * (row[i + 1, 6] - row[i, 6])
                    if cost < cheapest:
                        best, cheapest = i, cost
                w, v = row[best, 5], row[best + 1, 5]
                row[best, 6] = (w * row[best, 6] + v * row[best + 1, 6]) / (w + v)
                row[best, 1] = row[best + 1, 1]
                for a in range(2, 6):
                    row[best, a] += row[best + 1, a]
                for i in range(best + 1, held - 1):
                    for a in range(7):
                        row[i, a] = row[i + 1, a]
                held -= 1
            scale = total / colored if colored > _ZERO else _ZERO
            for i in range(held):
                out[r, i, 0] = row[i, 0]
                out[r, i, 1] = row[i, 1]
                for a in range(2, 6):
                    out[r, i, a] = row[i, a] * scale
            counts[r] = held
