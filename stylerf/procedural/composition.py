"""The subject of the procedural painting: a swirling night over bent hills, as regions, flow and colors.

Image coordinates: u to the right and v down, both 0..1. Each region has a stream function: strokes follow its contour
lines, and its colors change across them.
"""

from dataclasses import dataclass

import numpy as np

PALETTES = {
    "sky": ("#081338", "#0d2463", "#123f93", "#1f63b5", "#3f93c6", "#9cc8c4", "#e6dca4"),
    "glow": ("#fff1ae", "#ffd94d", "#fbb021", "#ee7d1b", "#d8431f", "#c08a2c", "#3f8fb0", "#14438f"),
    "range": ("#0c1235", "#1b2260", "#3a2f78", "#5c4593", "#2a5e9a", "#8f6f9e"),
    "far hill": ("#0f3a3c", "#1f6355", "#4f8a4c", "#a3a640", "#dfc04b", "#e58a2a"),
    "field": ("#6d1414", "#b3231a", "#de4a20", "#ef8226", "#f2b53a", "#f6dd80"),
    "near hill": ("#06221f", "#0f4038", "#256a3f", "#6d8f32", "#c7a431", "#173a74"),
    "tree": ("#04060f", "#0a1a24", "#0e3330", "#1f5a3a", "#5b4a1e", "#b0521d"),
}
CONTOUR = ("#05081e", "#0a1240", "#2a0b12")


@dataclass(frozen=True, eq=False)
class Subject:
    """regions [n, n] int: index into `names`; angles [n, n]: direction of strokes, radians; tones [n, n]: place in
    the region's palette, 0..1; detail [n, n]: 0 broad strokes .. 1 fine ones; outlines: curves [.., 2] in pixels
    (x, y) to be drawn as contours."""

    names: tuple[str, ...]
    regions: np.ndarray
    angles: np.ndarray
    tones: np.ndarray
    detail: np.ndarray
    outlines: list[np.ndarray]


def colors(name: str) -> np.ndarray:
    """Return the palette of a region, [k, 3] sRGB 0..1."""
    return hexadecimal(PALETTES[name])


def hexadecimal(codes: tuple[str, ...]) -> np.ndarray:
    """Convert '#rrggbb' codes to [k, 3], 0..1."""
    return np.array([[int(code[i : i + 2], 16) / 255 for i in (1, 3, 5)] for code in codes])


def _bump(u, v, at, radius):
    return np.exp(-((u - at[0]) ** 2 + (v - at[1]) ** 2) / (2 * radius**2))


def _wobble(u, v, random, cycles):
    """Return a smooth random function over the image, about -1..1: a few plane waves."""
    total = np.zeros_like(u)
    for _ in range(6):
        a, b = random.normal(0, cycles, 2)
        total += np.sin(2 * np.pi * (a * u + b * v + random.uniform()))
    return total / 2.5


def _sky(u, v, random, suns):
    """Return the stream function of the sky: vortices around eddies and suns, with a drift to the right."""
    stream = 0.95 * v + 0.07 * np.sin(2 * np.pi * (1.1 * u + 0.25)) + 0.012 * _wobble(u, v, random, 2.2)
    swirls = (((0.43, 0.25), 0.115, 0.34), ((0.585, 0.385), 0.075, -0.2), ((0.24, 0.43), 0.07, 0.15))
    for at, radius, strength in swirls:
        at = (at[0] + random.normal(0, 0.012), at[1] + random.normal(0, 0.012))
        stream = stream + strength * _bump(u, v, at, radius)
    for at, radius in suns:
        stream = stream - 0.42 * _bump(u, v, at, 1.25 * radius)
    return stream


def compose(size: int, seed: int) -> Subject:
    """Compose the subject at size x size pixels; the seed shifts suns, eddies and hills and sets all irregularity."""
    random = np.random.default_rng(seed)
    v, u = np.meshgrid((np.arange(size) + 0.5) / size, (np.arange(size) + 0.5) / size, indexing="ij")
    jitter = random.normal(0, 0.012, (8, 2))
    suns = [((0.775 + jitter[0, 0], 0.175 + jitter[0, 1]), 0.115), ((0.135 + jitter[1, 0], 0.135 + jitter[1, 1]), 0.06)]
    suns += [((0.52 + jitter[2, 0], 0.085), 0.03), ((0.93, 0.42 + jitter[3, 1]), 0.032), ((0.33, 0.06), 0.022)]
    bend = 0.012 * _wobble(u, v, random, 1.6)
    crest = 0.545 - 0.075 * np.sin(5.2 * u + 0.4) - 0.05 * np.sin(11.0 * u + 1.0 + jitter[4, 0] * 20) + bend
    far = 0.655 + 0.055 * np.sin(6.3 * u + 2.1 + jitter[5, 0] * 10) + bend
    field = 0.72 - 0.07 * np.cos(3.4 * (u - 0.62)) + 0.02 * np.sin(12 * u) + bend
    near = 0.985 - 0.20 * np.exp(-(((u - 0.02) / 0.36) ** 2)) - 0.13 * np.exp(-(((u - 1.05) / 0.33) ** 2)) + bend
    trunk = 0.205 + 0.035 * np.sin(8.5 * v + 0.6) + 0.3 * (v - 0.6) ** 2 * (v > 0.6)
    rise = np.clip((v - 0.17) / 0.75, 0, 1)
    half = 0.115 * rise**0.8 * (1 - 0.5 * rise**3) * (1 + 0.13 * np.sin(34 * v + 9 * u) + 0.1 * np.sin(61 * v))
    sky = _sky(u, v, random, suns)
    streams = {
        "sky": sky,
        "glow": sky,
        "range": 1.4 * (v - crest) + 0.30 * u + 0.05 * np.sin(17 * u + 9 * v),
        "far hill": (v - far) + 0.05 * np.sin(9 * u + 14 * v),
        "field": 0.34 * (u - 0.60 + 0.10 * np.sin(9 * v)) / (np.maximum(v - field, 0) + 0.085),
        "near hill": (v - near) + 0.10 * np.sin(5 * u + 3 * v),
        "tree": 1.3 * (u - trunk) / (half + 0.03) * 0.1 + 0.018 * np.sin(26 * v + 22 * u),
    }
    names = tuple(streams)
    glow = np.min([np.hypot(u - at[0], v - at[1]) / radius for at, radius in suns], axis=0)
    glow = glow * (1 + 0.035 * np.sin(9 * np.arctan2(v - suns[0][0][1], u - suns[0][0][0]) + 30 * glow))
    regions = np.full((size, size), names.index("sky"))
    for name, inside in (
        ("glow", glow < 1.45),
        ("range", v > crest),
        ("far hill", v > far),
        ("field", v > field),
        ("near hill", v > near),
        ("tree", np.abs(u - trunk) < half),
    ):
        regions[inside] = names.index(name)
    bands = {name: 0.5 + 0.5 * np.sin(2 * np.pi * cycles * streams[name]) for name, cycles in (
        ("sky", 7.0), ("range", 7.0), ("far hill", 13.0), ("field", 5.0), ("near hill", 9.0), ("tree", 9.0)
    )}  # fmt: skip
    bands["sky"] = 0.72 * bands["sky"] ** 1.6 + 0.26 * np.exp(-((v - crest + 0.05) ** 2) / 0.004)
    bands["glow"] = np.clip(glow / 1.45, 0, 1) ** 1.35
    angles, tones = np.zeros((size, size)), np.zeros((size, size))
    for index, name in enumerate(names):
        down, right = np.gradient(streams[name])
        here = regions == index
        angles[here] = np.arctan2(right, -down)[here]  # at right angles to the gradient (right, down)
        tones[here] = bands[name][here]
    detail = np.clip(1.2 - 0.5 * glow, 0, 1) * (regions <= 1)
    detail = np.maximum(detail, np.where(regions == names.index("tree"), 0.5, 0.25 * (regions > 1)))
    return Subject(names, regions, angles, np.clip(tones, 0, 1), detail, _outlines(regions, names, glow, streams, size))


def _outlines(regions, names, glow, streams, size) -> list[np.ndarray]:
    """Return the edges of the regions, rings around the suns, and furrows of the hills."""
    from skimage.measure import find_contours

    curves = []
    for name in names[2:]:
        curves += find_contours((regions == names.index(name)).astype(float), 0.5)
    for level in (0.62, 1.4):
        curves += find_contours(np.where(regions <= 1, glow, 9.0), level)
    sky = np.where(regions == 0, streams["sky"], np.nan)
    for level in np.arange(-0.4, 1.4, 1 / 7):
        curves += find_contours(sky, level)
    for name, levels in (("far hill", np.arange(0.05, 0.3, 0.05)), ("field", np.arange(-3, 3, 0.2)),
                         ("near hill", np.arange(0.02, 0.4, 0.055)),
                         ("range", np.arange(-0.2, 0.9, 0.12))):  # fmt: skip
        inside = np.where(regions == names.index(name), streams[name], np.nan)
        for level in levels:
            curves += find_contours(inside, level)
    margin = 3.0
    kept = []
    for curve in curves:
        curve = curve[:, ::-1]
        inner = ((curve > margin) & (curve < size - margin)).all(axis=1)
        for piece in np.split(curve, np.flatnonzero(np.diff(inner.astype(int))) + 1):
            if len(piece) > 24 and margin < piece[0].min() and piece[0].max() < size - margin:
                kept.append(piece)
    return kept
