"""A procedural painting: layers of oriented, thick strokes from broad to fine, contours, and relief."""

from dataclasses import dataclass

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.procedural.composition import CONTOUR, Subject, colors, compose, hexadecimal
from stylerf.procedural.strokes import follow_flow, joined, lay_strokes, relief

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
    """Paint [size, size, 3] float32, sRGB 0..1; the same bytes for the same size and seed."""
    if size < 32:
        raise InvalidValue(f"a painting of {size} pixels is too small for strokes; 32 at least")
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
    # Starts outside are moved to the edge, which would otherwise get fewer strokes.
    starts = np.clip(random.uniform(-0.04 * size, 1.04 * size, (wanted, 2)), 0, size - 1)
    columns, rows = starts.astype(int).T
    kept = subject.detail[rows, columns] >= layer.detail
    starts, columns, rows = starts[kept], columns[kept], rows[kept]
    # Fine subjects take narrower and shorter strokes of every brush.
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
