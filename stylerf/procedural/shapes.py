"""Signed distance functions of the still life's shapes, one point at a time, compiled.

Every function takes a point in the shape's local frame (z up, resting on z = 0 unless noted) and returns a distance in
scene units: negative inside, zero on the surface, and outside never more than the true distance (each combines
functions with Lipschitz constant 1 by min, max and smooth min), so that a ray can always safely step that far.
"""

from math import hypot, sqrt

from stylerf.procedural import compiled

DISC, VASE, PEAR, APPLE, LEMON, BOX, BOOK, TORUS, SPHERE, HOLDER, CANDLE, FLAME, GRAPES = range(13)


@compiled
def smooth_min(a, b, k):
    """Quadratic smooth minimum of two distances with blend width k; under min(a, b) by at most k/4."""
    h = max(k - abs(a - b), 0.0) / k
    return min(a, b) - 0.25 * h * h * k


@compiled
def ball(x, y, z, radius):
    """Sphere about the origin."""
    return sqrt(x * x + y * y + z * z) - radius


@compiled
def box(x, y, z, a, b, c, rounding):
    """Box about the origin with half sides (a, b, c), its edges rounded by `rounding` within these sides."""
    qx, qy, qz = abs(x) - a + rounding, abs(y) - b + rounding, abs(z) - c + rounding
    ox, oy, oz = max(qx, 0.0), max(qy, 0.0), max(qz, 0.0)
    return sqrt(ox * ox + oy * oy + oz * oz) + min(max(qx, qy, qz), 0.0) - rounding


@compiled
def cylinder(x, y, z, radius, low, high, rounding):
    """Upright cylinder from z = low to z = high with rounded rims."""
    qr = hypot(x, y) - radius + rounding
    qz = abs(z - 0.5 * (low + high)) - 0.5 * (high - low) + rounding
    return hypot(max(qr, 0.0), max(qz, 0.0)) + min(max(qr, qz), 0.0) - rounding


@compiled
def ring(x, y, z, major, minor):
    """Torus about the z axis, centered at the origin."""
    return hypot(hypot(x, y) - major, z) - minor


@compiled
def stick(x, y, z, ax, ay, az, bx, by, bz, radius):
    """Capsule from point a to point b."""
    px, py, pz = x - ax, y - ay, z - az
    qx, qy, qz = bx - ax, by - ay, bz - az
    h = min(max((px * qx + py * qy + pz * qz) / (qx * qx + qy * qy + qz * qz), 0.0), 1.0)
    return ball(px - h * qx, py - h * qy, pz - h * qz, radius)


@compiled
def round_cone(x, y, z, low_radius, high_radius, height):
    """Convex hull of a sphere at z = 0 and a sphere at z = height."""
    b = (low_radius - high_radius) / height
    a = sqrt(1.0 - b * b)
    r = hypot(x, y)
    k = z * a - r * b
    if k < 0.0 and z * a * a - r * a * b < 0.0:
        return hypot(r, z) - low_radius
    along = r * (-b) + z * a
    if along < 0.0:
        return hypot(r, z) - low_radius
    if along > a * height:
        return hypot(r, z - height) - high_radius
    return r * a + z * b - low_radius


@compiled
def spindle(r, z, half_length, half_width):
    """Solid of revolution of a circle's arc about its chord: points at (0, +-half_length), waist `half_width`."""
    d = 0.5 * (half_length * half_length - half_width * half_width) / half_width  # center of the arc at r = -d
    z = abs(z)
    if half_length * r < d * (z - half_length):
        return hypot(r, z - half_length)
    return hypot(r + d, z) - (d + half_width)


@compiled
def vase(x, y, z):
    """Amphora of height 1.12: round-cone body, neck, lip and foot, hollow neck; resting on z = 0."""
    body = round_cone(x, y, z - 0.13, 0.14, 0.272, 0.42)
    neck = cylinder(x, y, z, 0.088, 0.5, 1.06, 0.02)
    d = smooth_min(body, neck, 0.2)
    d = smooth_min(d, ring(x, y, z - 1.07, 0.098, 0.036), 0.06)
    d = smooth_min(d, cylinder(x, y, z, 0.165, 0.0, 0.05, 0.018), 0.06)
    hole = cylinder(x, y, z, 0.068, 0.72, 1.4, 0.02)
    return max(d, -z, -hole)


@compiled
def pear(x, y, z):
    """Pear of height 0.5 with a bent stem; its neck leans towards +x; resting on z = 0."""
    low = ball(x, y, z - 0.19, 0.19)
    high = ball(x - 0.03, y, z - 0.425, 0.07)
    d = smooth_min(low, high, 0.2)
    stem = stick(x, y, z, 0.035, 0.0, 0.46, 0.075, 0.01, 0.585, 0.0125)
    return smooth_min(d, stem, 0.015)


@compiled
def apple(x, y, z):
    """Apple of radius 0.2 (a torus that overlaps itself: dimples at both poles) with a stem; resting on z = 0."""
    r = hypot(x, y)
    d = hypot(r - 0.07, z - 0.155) - 0.135
    d = smooth_min(d, ball(x, y, z - 0.17, 0.13), 0.06)
    d = max(d, -ball(x, y, z - 0.36, 0.085))
    d = max(d, -z + 0.004)
    stem = stick(x, y, z, 0.0, 0.0, 0.3, 0.03, 0.012, 0.395, 0.012)
    return min(d, stem)


@compiled
def lemon(x, y, z):
    """Lemon about the origin, its axis along x: half length 0.2, half width 0.135."""
    r = hypot(y, z)
    body = spindle(r, x, 0.165, 0.105) - 0.03
    tip = stick(x, y, z, -0.19, 0.0, 0.0, 0.185, 0.0, 0.0, 0.022)
    return smooth_min(body, tip, 0.06)


@compiled
def book(x, y, z, a, b, c):
    """Closed book about the origin, half sides (a, b, c), flat: covers, spine at y = -b, inset pages."""
    cover = 0.16 * c
    d = box(x, y, abs(z) - c + cover, a, b, cover, 0.35 * cover)
    d = min(d, box(x, y + b - cover, z, a, cover, c, 0.35 * cover))
    return min(d, box(x, y + 0.012, z, a - 0.024, b - 0.02, c - cover, 0.002))


@compiled
def holder(x, y, z):
    """Brass candle holder: saucer with a raised rim, socket, finger ring towards -y; resting on z = 0."""
    d = cylinder(x, y, z, 0.19, 0.0, 0.022, 0.01)
    d = smooth_min(d, ring(x, y, z - 0.03, 0.19, 0.017), 0.03)
    d = smooth_min(d, cylinder(x, y, z, 0.078, 0.0, 0.115, 0.012), 0.05)
    d = min(d, ring(x, y, z - 0.115, 0.078, 0.014))
    return min(d, ring(y + 0.235, z - 0.055, x, 0.042, 0.0135))


@compiled
def candle(x, y, z, height):
    """Candle of radius 0.062 with a hollowed top and a wick; resting on z = 0."""
    d = cylinder(x, y, z, 0.062, 0.0, height, 0.014)
    d = max(d, -ball(x, y, z - height - 0.046, 0.06))
    drip = stick(x, y, z, 0.058, 0.02, height - 0.015, 0.06, 0.02, height - 0.14, 0.013)
    d = smooth_min(d, drip, 0.02)
    return min(d, stick(x, y, z, 0.0, 0.0, height - 0.02, 0.004, 0.0, height + 0.035, 0.006))


@compiled
def flame(x, y, z):
    """Teardrop of height 0.16 above the origin."""
    return round_cone(x, y, z - 0.034, 0.034, 0.006, 0.12)


@compiled
def stalk(x, y, z):
    """The stalk of the grapes."""
    return stick(x, y, z, -0.16, 0.0, 0.1, -0.29, 0.04, 0.13, 0.013)


@compiled
def grapes(x, y, z):
    """A bunch of grapes: four rows that narrow towards +x, a second layer on top and a stalk; on z = 0."""
    radius = 0.068
    d = 1e9
    for row in range(4):
        count = 4 - row
        cx = -0.15 + 0.112 * row
        for i in range(count):
            cy = (i - 0.5 * (count - 1)) * 0.128
            lift = 0.008 * ((row * 5 + i * 3) % 4)
            d = min(d, ball(x - cx, y - cy, z - radius - lift, radius))
    for row in range(3):
        count = 3 - row
        cx = -0.112 + 0.108 * row
        for i in range(count):
            cy = (i - 0.5 * (count - 1)) * 0.124
            d = min(d, ball(x - cx, y - cy, z - radius - 0.1, radius))
    return min(d, stalk(x, y, z))


@compiled
def shape_distance(kind, p, x, y, z):
    """Signed distance to a shape of `kind` with parameters p [4] at the point (x, y, z) in its local frame."""
    if kind == DISC:
        return cylinder(x, y, z, p[0], -p[1], 0.0, p[2])
    if kind == VASE:
        return vase(x, y, z)
    if kind == PEAR:
        return pear(x, y, z)
    if kind == APPLE:
        return apple(x, y, z)
    if kind == LEMON:
        return lemon(x, y, z)
    if kind == BOX:
        return box(x, y, z, p[0], p[1], p[2], p[3])
    if kind == BOOK:
        return book(x, y, z, p[0], p[1], p[2])
    if kind == TORUS:
        return ring(x, y, z, p[0], p[1])
    if kind == SPHERE:
        return ball(x, y, z, p[0])
    if kind == HOLDER:
        return holder(x, y, z)
    if kind == CANDLE:
        return candle(x, y, z, p[0])
    if kind == FLAME:
        return flame(x, y, z)
    return grapes(x, y, z)
