"""The still life's materials: color, gloss and emission of every shape at a point in its local frame, compiled.

Colors are linear Rec.709. A surface is (red, green, blue, specular, roughness, metal, glow): diffuse color 0..1,
reflectance at normal incidence 0..1, width of highlights 0..1, metalness 0..1 (metal tints its reflection with its
color and has no diffuse part), emitted light.
"""

from math import atan2, cos, exp, floor, hypot, pi, sin

from stylerf.procedural import compiled, shapes
from stylerf.procedural.noise import fractal, lattice, noise, smoothstep


@compiled
def mixed(t, a, b):
    """Color a where t = 0, b where t = 1."""
    s = 1.0 - t
    return s * a[0] + t * b[0], s * a[1] + t * b[1], s * a[2] + t * b[2]


@compiled
def scaled(a, s):
    """Color a times s."""
    return a[0] * s, a[1] * s, a[2] * s


@compiled
def wood(x, y, z, radius, seed):
    """Planks with grain, knots and seams, and a dark inlaid ring near the rim."""
    plank = floor((y + 3.0) / 0.29)
    across = (y + 3.0) / 0.29 - plank
    shift = 7.0 * lattice(int(plank), 3, 1, seed)
    warp = fractal(1.1 * x + shift, 2.6 * y + shift, 0.0, 3, seed + 11)
    rings = 0.5 + 0.5 * sin(46.0 * (0.22 * y + 0.42 * warp) + shift)
    fiber = fractal(5.0 * x + shift, 60.0 * y, 0.0, 2, seed + 23)
    t = 0.55 * rings + 0.45 * fiber
    color = mixed(t, (0.20, 0.078, 0.026), (0.47, 0.235, 0.088))
    color = scaled(color, 0.78 + 0.5 * lattice(int(plank), 8, 2, seed))
    seam = smoothstep(0.0, 0.035, across) * smoothstep(0.0, 0.035, 1.0 - across)
    r = hypot(x, y)
    inside = 1.0 - smoothstep(0.865 * radius, 0.875 * radius, r)
    color = scaled(color, 1.0 - (1.0 - (0.35 + 0.65 * seam)) * inside)
    inlay = smoothstep(0.865 * radius, 0.875 * radius, r) * (1.0 - smoothstep(0.9 * radius, 0.91 * radius, r))
    color = mixed(inlay, color, (0.045, 0.018, 0.010))
    rim = smoothstep(0.9 * radius, 0.91 * radius, r)
    turned = 0.75 + 0.5 * fractal(3.0 * atan2(y, x), 40.0 * r, 30.0 * z, 2, seed + 5)
    color = mixed(rim, color, scaled((0.27, 0.112, 0.038), turned))
    return color[0], color[1], color[2], 0.035, 0.42, 0.0, 0.0


@compiled
def glazed_vase(x, y, z, seed):
    """Cobalt glaze, a cream band with a wave and gold lines on the shoulder, bare clay at the foot."""
    angle = atan2(y, x)
    cloud = fractal(5.0 * x, 5.0 * y, 5.0 * z, 3, seed + 31)
    color = mixed(smoothstep(0.3, 0.75, cloud), (0.010, 0.045, 0.23), (0.020, 0.12, 0.42))
    band = smoothstep(0.395, 0.405, z) * (1.0 - smoothstep(0.605, 0.615, z))
    wave = abs(z - 0.505 - 0.052 * sin(9.0 * angle))
    figure = mixed(smoothstep(0.022, 0.032, wave), (0.02, 0.09, 0.36), (0.80, 0.72, 0.55))
    dots = hypot(0.25 * (((9.0 * angle / (2.0 * pi) + 0.25) % 1.0) - 0.5) * 2.0 * pi / 9.0, z - 0.475)
    figure = mixed(1.0 - smoothstep(0.017, 0.024, dots), figure, (0.62, 0.10, 0.03))
    color = mixed(band, color, figure)
    gold = max(1.0 - abs(z - 0.385) / 0.016, 1.0 - abs(z - 0.625) / 0.016, 1.0 - abs(z - 0.93) / 0.016)
    gilt = smoothstep(0.0, 0.3, gold)
    color = mixed(gilt, color, (0.72, 0.42, 0.10))
    clay = 1.0 - smoothstep(0.055, 0.07, z)
    color = mixed(clay, color, (0.34, 0.13, 0.06))
    return color[0], color[1], color[2], 0.055 * (1.0 - 0.7 * clay), 0.08 + 0.5 * clay, 0.75 * gilt, 0.0


@compiled
def fruit(kind, x, y, z, seed):
    """Skins of pear, apple, lemon and grapes."""
    if kind == shapes.PEAR:
        if z > 0.492 - 0.25 * max(hypot(x - 0.05, y) - 0.02, 0.0) and hypot(x - 0.045 - 0.3 * (z - 0.5), y) < 0.028:
            return 0.11, 0.055, 0.02, 0.03, 0.7, 0.0, 0.0
        mottle = fractal(9.0 * x, 9.0 * y, 7.0 * z, 3, seed + 41)
        color = mixed(smoothstep(0.3, 0.7, mottle), (0.36, 0.37, 0.045), (0.56, 0.44, 0.07))
        blush = smoothstep(-0.05, 0.17, 0.75 * x - 0.6 * y + 0.16 * (mottle - 0.5))
        color = mixed(0.75 * blush, color, (0.55, 0.11, 0.03))
        speck = smoothstep(0.72, 0.8, noise(55.0 * x, 55.0 * y, 55.0 * z, seed + 43))
        color = mixed(0.55 * speck, color, (0.20, 0.12, 0.03))
        return color[0], color[1], color[2], 0.035, 0.33, 0.0, 0.0
    if kind == shapes.APPLE:
        r = hypot(x, y)
        if z > 0.262 and r < 0.05 and hypot(x - 0.3 * (z - 0.28), y) < 0.022:
            return 0.10, 0.05, 0.02, 0.03, 0.7, 0.0, 0.0
        streak = fractal(13.0 * x / (r + 0.06), 13.0 * y / (r + 0.06), 2.4 * z, 3, seed + 51)
        color = mixed(smoothstep(0.45, 0.72, streak), (0.50, 0.022, 0.014), (0.66, 0.15, 0.03))
        top = smoothstep(0.1, 0.02, r) * smoothstep(0.22, 0.27, z) if r < 0.1 else 0.0
        color = mixed(top, color, (0.48, 0.40, 0.07))
        return color[0], color[1], color[2], 0.045, 0.2, 0.0, 0.0
    if kind == shapes.LEMON:
        pores = noise(48.0 * x, 48.0 * y, 48.0 * z, seed + 61)
        color = mixed(pores, (0.66, 0.39, 0.010), (0.76, 0.51, 0.022))
        tip = smoothstep(0.145, 0.2, abs(x))
        color = mixed(0.6 * tip, color, (0.40, 0.42, 0.05))
        return color[0], color[1], color[2], 0.04, 0.32, 0.0, 0.0
    if shapes.stalk(x, y, z) < 0.003:
        return 0.14, 0.12, 0.035, 0.03, 0.7, 0.0, 0.0
    bloom = fractal(14.0 * x, 14.0 * y, 14.0 * z, 3, seed + 71)
    color = mixed(smoothstep(0.35, 0.75, bloom), (0.045, 0.008, 0.035), (0.17, 0.10, 0.20))
    return color[0], color[1], color[2], 0.045, 0.24, 0.0, 0.0


@compiled
def bound_book(x, y, z, a, b, c, seed):
    """Teal cloth with a gilt frame on the cover and gilt bands on the spine; cream pages."""
    cover = 0.16 * c
    if abs(z) < c - 1.9 * cover and y > -b + 2.2 * cover:
        leaf = 0.5 + 0.5 * sin(2.0 * pi * z / (0.30 * c))
        tone = 0.72 + 0.28 * leaf
        return 0.74 * tone, 0.65 * tone, 0.47 * tone, 0.02, 0.8, 0.0, 0.0
    weave = noise(70.0 * x, 70.0 * y, 70.0 * z, seed + 81)
    color = mixed(weave, (0.010, 0.115, 0.115), (0.018, 0.165, 0.155))
    gilt = 0.0
    if abs(z) > c - 0.3 * cover:
        inset = min(a - abs(x), b - abs(y))
        gilt = smoothstep(0.035, 0.042, inset) * (1.0 - smoothstep(0.054, 0.061, inset))
        lozenge = abs(x) / 0.13 + abs(y) / 0.085
        gilt = max(gilt, smoothstep(0.78, 0.84, lozenge) * (1.0 - smoothstep(1.0, 1.06, lozenge)))
    elif y < -b + 2.0 * cover:
        gilt = smoothstep(0.62, 0.8, cos(2.0 * pi * x / 0.12))
    color = mixed(gilt, color, (0.66, 0.38, 0.09))
    return color[0], color[1], color[2], 0.03, 0.5 - 0.25 * gilt, 0.6 * gilt, 0.0


@compiled
def surface(kind, p, x, y, z, seed):
    """Surface of a solid of `kind` with parameters p [4] at (x, y, z) in its local frame (see the module docstring)."""
    if kind == shapes.DISC:
        return wood(x, y, z, p[0], seed)
    if kind == shapes.VASE:
        return glazed_vase(x, y, z, seed)
    if kind in (shapes.PEAR, shapes.APPLE, shapes.LEMON, shapes.GRAPES):
        return fruit(kind, x, y, z, seed)
    if kind == shapes.BOOK:
        return bound_book(x, y, z, p[0], p[1], p[2], seed)
    if kind == shapes.BOX:
        s = 0.998 * 2.0 / p[0]  # four squares per side; shrunk so that no face is on a boundary between squares
        odd = (floor(s * x) + floor(s * y) + floor(s * z)) % 2.0
        grain = 0.85 + 0.3 * noise(18.0 * x, 18.0 * y, 18.0 * z, seed + 91)
        if odd > 0.5:
            return 0.70 * grain, 0.60 * grain, 0.43 * grain, 0.035, 0.4, 0.0, 0.0
        return 0.022 * grain, 0.026 * grain, 0.040 * grain, 0.035, 0.4, 0.0, 0.0
    if kind == shapes.TORUS:
        turn = atan2(y, x) / (2.0 * pi)
        around = atan2(z, hypot(x, y) - p[0]) / (2.0 * pi)
        stripe = abs(((10.0 * turn + around) % 1.0) - 0.5)
        color = mixed(smoothstep(0.235, 0.265, stripe), (0.62, 0.13, 0.018), (0.76, 0.66, 0.48))
        return color[0], color[1], color[2], 0.04, 0.25, 0.0, 0.0
    if kind == shapes.SPHERE:
        vein = abs(fractal(4.5 * x, 4.5 * y, 4.5 * z, 4, seed + 101) - 0.5)
        color = mixed(1.0 - smoothstep(0.0, 0.045, vein), (0.008, 0.13, 0.055), (0.10, 0.42, 0.20))
        return color[0], color[1], color[2], 0.06, 0.06, 0.0, 0.0
    if kind == shapes.HOLDER:
        worn = fractal(12.0 * x, 12.0 * y, 12.0 * z, 3, seed + 111)
        color = mixed(worn, (0.46, 0.235, 0.045), (0.68, 0.40, 0.10))
        return color[0], color[1], color[2], 0.42, 0.24, 0.93, 0.0
    if kind == shapes.CANDLE:
        if z > p[0] + 0.002 and hypot(x, y) < 0.03:
            return 0.02, 0.015, 0.01, 0.02, 0.9, 0.0, 0.0
        through = exp(-(p[0] - z) / 0.09)
        return 0.80, 0.68, 0.47 - 0.12 * through, 0.03, 0.4, 0.0, 0.55 * through
    heart = smoothstep(0.0, 0.05, z) * (1.0 - smoothstep(0.05, 0.15, z))
    return 1.0, 0.30 + 0.36 * heart, 0.035 + 0.16 * heart, 0.0, 1.0, 0.0, 2.4 + 1.2 * heart
