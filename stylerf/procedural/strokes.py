"""Brush strokes on a canvas, compiled: paths along a flow, bristles that mix two paints and run dry, relief.

A canvas is two arrays: paint [n, n, 3] (sRGB-encoded, 0..1) and height [n, n] (thickness of the paint; 1 is a full
brush). Strokes lie in arrays over their points: points [m, 2] (x, y in pixels), offsets [k + 1] of each stroke.
"""

from math import cos, floor, sin

import numpy as np

from stylerf.procedural import released
from stylerf.procedural.noise import lattice, noise, smoothstep


@released
def follow_flow(starts, lengths, angles, regions, step):
    """Paths along a flow from starts [k, 2], up to `lengths` [k] pixels, ended where the region changes.

    angles [n, n] radians: direction of the flow at each pixel; regions [n, n] int. A path runs half its length back
    and half forward, so that its start is its middle. Returns points [m, 2] and offsets [k + 1].
    """
    size = angles.shape[0]
    most = int(lengths.max() / step) + 3
    points = np.empty((starts.shape[0] * most, 2))
    offsets = np.zeros(starts.shape[0] + 1, np.int64)
    trail = np.empty((most, 2))
    total = 0
    for k in range(starts.shape[0]):
        half = int(0.5 * lengths[k] / step)
        home = regions[min(max(int(starts[k, 1]), 0), size - 1), min(max(int(starts[k, 0]), 0), size - 1)]
        for sense in (-1, 1):
            x, y = starts[k, 0], starts[k, 1]
            heading, count = 0.0, 0
            for i in range(half):
                column, row = int(floor(x)), int(floor(y))
                if column < 0 or row < 0 or column >= size or row >= size or regions[row, column] != home:
                    break
                angle = angles[row, column]
                dx, dy = cos(angle), sin(angle)
                if i == 0:
                    dx, dy = sense * dx, sense * dy
                elif dx * cos(heading) + dy * sin(heading) < 0.0:  # a flow has no sign: keep on the way taken
                    dx, dy = -dx, -dy
                heading = np.arctan2(dy, dx)
                trail[count, 0], trail[count, 1] = x, y
                count += 1
                x, y = x + step * dx, y + step * dy
            for i in range(count):
                source = count - 1 - i if sense < 0 else i
                if sense > 0 and i == 0:
                    continue
                points[total, 0], points[total, 1] = trail[source, 0], trail[source, 1]
                total += 1
        offsets[k + 1] = total
    return points[:total].copy(), offsets


@released
def lay_strokes(paint, height, points, offsets, widths, first, second, dryness, thickness, seed):
    """Lay strokes on a canvas one over the other, in place.

    widths [k]: pixels. first, second [k, 3]: the two paints on the brush, mixed from bristle to bristle.
    dryness 0..1: how soon bristles run dry; thickness: of the paint laid.
    """
    size = paint.shape[0]
    stamp = np.full((size, size), -1, np.int64)
    for k in range(offsets.shape[0] - 1):
        begin, end = offsets[k], offsets[k + 1]
        count = end - begin
        if count < 4:
            continue
        half = 0.5 * widths[k]
        bristles = max(3.0, widths[k] / 2.4)
        lean = 0.5 * lattice(k, 7, 1, seed)
        for i in range(count):
            s = i / (count - 1.0)
            p, q = points[begin + max(i - 1, 0)], points[begin + min(i + 1, count - 1)]
            tx, ty = q[0] - p[0], q[1] - p[1]
            length = max(np.hypot(tx, ty), 1e-9)
            nx, ny = -ty / length, tx / length
            swell = smoothstep(0.0, 0.12, s) * (0.35 + 0.65 * smoothstep(0.0, 0.35, 1.0 - s))
            reach = half * (0.3 + 0.7 * swell)
            across = int(reach / 0.35) + 1
            for j in range(-across, across + 1):
                o = reach * j / across
                x, y = points[begin + i, 0] + o * nx, points[begin + i, 1] + o * ny
                column, row = int(floor(x)), int(floor(y))
                if column < 0 or row < 0 or column >= size or row >= size or stamp[row, column] == k:
                    continue
                lane = o / half * bristles
                hair = noise(lane + 31.0 * k, 2.2 * s, 0.0, seed)
                fine = noise(2.7 * lane + 11.0 * k, 5.0 * s, 3.0, seed + 1)
                edge = abs(o) / reach
                load = 1.0 - dryness * s * 1.2 - 0.55 * max(edge - 0.72, 0.0) / 0.28
                if hair * 0.72 + fine * 0.28 > load + 0.25:
                    continue
                stamp[row, column] = k
                t = min(max(1.5 * (hair - 0.5) + 0.45 + lean * o / half, 0.0), 1.0)
                light = 0.93 + 0.14 * fine
                cover = 0.94 if edge < 0.9 else 0.7
                for channel in range(3):
                    color = (first[k, channel] * (1.0 - t) + second[k, channel] * t) * light
                    paint[row, column, channel] += cover * (color - paint[row, column, channel])
                ridge = 0.75 * hair + 0.35 * fine + 0.35 * smoothstep(0.55, 0.9, edge)
                lift = thickness * swell * ridge * (1.0 - 0.5 * smoothstep(0.9, 1.0, edge))
                height[row, column] = 0.45 * height[row, column] + lift


def relief(paint: np.ndarray, height: np.ndarray, depth: float) -> np.ndarray:
    """The canvas [n, n, 3] lit from the upper left: ridges of paint catch light and cast shade.

    depth: height of a full brush in pixels. Returns sRGB-encoded 0..1.
    """
    down, right = np.gradient(height * depth)
    norm = np.sqrt(right**2 + down**2 + 1.0)
    lit = (0.50 * right + 0.62 * down + 0.61) / norm
    gloss = np.clip((0.27 * right + 0.33 * down + 0.90) / norm, 0.0, 1.0) ** 40
    flat_gloss = 0.90**40
    shade = np.clip(1.10 + 0.75 * (lit - 0.61), 0.4, 1.7)[..., None]
    return np.clip(paint * shade + 0.10 * np.clip(gloss - flat_gloss, 0.0, 1.0)[..., None], 0.0, 1.0)


def joined(paths: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Paths [.., 2] one after the other: points [m, 2] and offsets [k + 1]."""
    offsets = np.cumsum([0, *(len(path) for path in paths)]).astype(np.int64)
    return np.concatenate([np.zeros((0, 2)), *paths]), offsets
