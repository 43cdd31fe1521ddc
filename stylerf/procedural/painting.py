"""A procedural painting: layers of oriented, thick strokes from broad to fine, contours, and relief.

Strokes follow a flow; their bristles mix two paints and run dry. A canvas is two arrays: paint [n, n, 3] (sRGB-encoded,
0..1) and height [n, n] (thickness of the paint; 1 is a full brush). Strokes are stored in arrays: points [m, 2] (x, y
in pixels), offsets [k + 1] of each stroke.
"""

from dataclasses import dataclass
from math import cos, floor, sin

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.procedural import released
from stylerf.procedural.composition import CONTOUR, Subject, colors, compose, hexadecimal
from stylerf.procedural.noise import lattice, noise, smoothstep

FINER = 2  # supersampling factor of the canvas


@dataclass(frozen=True)
class Layer:
    """Strokes of one brush.

    Widths and lengths are fractions of the image's side. cover: mean number of strokes over a point. accent: fraction
    of strokes in a random color of the palette.
    """

    width: float
    length: float
    cover: float
    accent: float
    dryness: float
    thickness: float
    detail: float = 0.0


LAYERS = (
    Layer(0.050, 0.22, 2.6, 0.00, 0.15, 0.5),
    Layer(0.026, 0.17, 2.2, 0.10, 0.30, 0.9),
    Layer(0.0155, 0.12, 1.05, 0.16, 0.40, 1.15),
    Layer(0.0105, 0.075, 1.5, 0.14, 0.35, 1.3, detail=0.35),
)
GROUND = "#5a2315"  # a warm ground that shows between the strokes


def paint(size: int = 512, seed: int = 0) -> np.ndarray:
    """Return a painting [size, size, 3] float32, sRGB 0..1; bit-identical for the same size and seed."""
    if size < 32:
        raise InvalidValue(f"a painting of {size} pixels is too small for strokes; at least 32 are needed")
    random = np.random.default_rng([seed, 1])
    large = FINER * size
    subject = compose(large, seed)
    canvas = np.empty((large, large, 3))
    canvas[:] = hexadecimal((GROUND,))[0]
    height = 0.10 * _weave(large)
    for number, layer in enumerate(LAYERS):
        _paint_layer(canvas, height, subject, layer, random, 1000 * seed + number)
        if number == 2:
            _draw_contours(canvas, height, subject, random, 1000 * seed + 50)
    lit = relief(canvas, height, 0.0042 * large)
    return lit.reshape(size, FINER, size, FINER, 3).mean(axis=(1, 3)).astype(np.float32)


def _paint_layer(canvas, height, subject: Subject, layer: Layer, random, seed: int) -> None:
    """Paint a layer of strokes over the whole image, or where the subject has at least the layer's detail."""
    size = len(canvas)
    width, length = layer.width * size, layer.length * size
    wanted = int(layer.cover * size * size / (0.75 * width * length))
    # Starting points outside are moved to the edge, which would otherwise get fewer strokes.
    starts = np.clip(random.uniform(-0.04 * size, 1.04 * size, (wanted, 2)), 0, size - 1)
    columns, rows = starts.astype(int).T
    kept = subject.detail[rows, columns] >= layer.detail
    starts, columns, rows = starts[kept], columns[kept], rows[kept]
    # Detailed subjects get narrower and shorter strokes from every brush.
    scale = (1 - 0.45 * subject.detail[rows, columns]) * np.exp(random.normal(0, 0.22, len(starts)))
    turned = subject.angles + 0.16 * np.sin(np.arange(size) * 0.02)[None]
    points, offsets = follow_flow(starts, length * scale, turned, subject.regions, 0.6)
    first, second = _paints(subject, rows, columns, layer.accent, random)
    lay_strokes(canvas, height, points, offsets, width * scale, first, second, layer.dryness, layer.thickness, seed)


def _paints(subject: Subject, rows, columns, accent: float, random) -> tuple[np.ndarray, np.ndarray]:
    """Return the two paints of each stroke, [k, 3] each: neighbors in the palette of its region."""
    count = len(rows)
    tones = np.clip(subject.tones[rows, columns] + random.normal(0, 0.07, count), 0, 1)
    odd = random.uniform(size=count) < accent
    tones = np.where(odd, random.uniform(size=count) ** 1.3, tones)
    drift = np.clip(tones + random.normal(0, 0.16, count), 0, 1)
    first, second = np.empty((count, 3)), np.empty((count, 3))
    for index, name in enumerate(subject.names):
        here = subject.regions[rows, columns] == index
        first[here], second[here] = _along(colors(name), tones[here]), _along(colors(name), drift[here])
    shift = np.exp(random.normal(0, 0.07, (count, 1))) * np.exp(random.normal(0, 0.03, (count, 3)))
    return np.clip(first * shift, 0, 1), np.clip(second * shift, 0, 1)


def _along(palette: np.ndarray, tones: np.ndarray) -> np.ndarray:
    """Interpolate a palette linearly at positions 0..1; colors [k, 3]."""
    places = np.linspace(0, 1, len(palette))
    return np.stack([np.interp(tones, places, palette[:, channel]) for channel in range(3)], axis=-1)


def _draw_contours(canvas, height, subject: Subject, random, seed: int) -> None:
    """Draw dark lines along the subject's outlines, broken and of uneven pressure."""
    size = len(canvas)
    paths = []
    for curve in subject.outlines:
        at = 0
        while at < len(curve) - 20:
            piece = int(random.uniform(0.10, 0.30) * size)
            path = curve[at : at + piece]
            if len(path) > 0.03 * size:
                window = np.ones(9) / 9
                smooth = [np.convolve(np.pad(axis, 4, mode="edge"), window, mode="valid") for axis in path.T]
                paths.append(np.stack(smooth, axis=-1) + random.normal(0, 0.0012 * size, 2))
            at += int(piece * random.uniform(0.85, 1.15))
    order = random.permutation(len(paths))
    points, offsets = joined([paths[i] for i in order])
    count = len(paths)
    pigments = hexadecimal(CONTOUR)
    first, second = pigments[random.integers(0, 3, count)], pigments[random.integers(0, 3, count)]
    widths = random.uniform(0.0055, 0.0115, count) * size
    lay_strokes(canvas, height, points, offsets, widths, first, second, 0.25, 0.9, seed)


def _weave(size: int) -> np.ndarray:
    """Return the height of the canvas' threads, [size, size], about 0..1, with a period of five pixels."""
    along = np.sin(2 * np.pi * np.arange(size) / 5)
    return 0.5 + 0.25 * (along[:, None] + along[None, :])


@released
def follow_flow(starts, lengths, angles, regions, step):
    """Trace paths along a flow from starts [k, 2], up to `lengths` [k] pixels, ending where the region changes.

    angles [n, n] radians: direction of the flow at each pixel; regions [n, n] int. A path runs half its length backward
    and half forward, so its start is its middle. Returns points [m, 2] and offsets [k + 1].
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
                elif dx * cos(heading) + dy * sin(heading) < 0.0:  # a flow has no sign: keep the current direction
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
    """Paint strokes on a canvas, one over another, in place.

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
    """Return the canvas [n, n, 3] lit from the upper left: ridges of paint catch light and cast shadows.

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
    """Concatenate paths [.., 2]: points [m, 2] and offsets [k + 1]."""
    offsets = np.cumsum([0, *(len(path) for path in paths)]).astype(np.int64)
    return np.concatenate([np.zeros((0, 2)), *paths]), offsets
