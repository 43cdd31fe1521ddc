"""Light on the still life, compiled: a warm soft key light, a sky, bounced light, reflections, and the pixel loop.

Colors are linear Rec.709 until `toned` (a filmic curve, still display-linear, 0..1); pixels are averaged over their
samples there and encoded to sRGB by the caller's last step.
"""

from math import sqrt

from stylerf.procedural import compiled, released, shapes
from stylerf.procedural.materials import surface
from stylerf.procedural.noise import smoothstep
from stylerf.procedural.tracing import MISS, nearest_hit, normal_at, openness, soft_shadow, to_local

KEY = (-0.4807, -0.5608, 0.6743)  # unit direction towards the key light: front left, 42 degrees up
KEY_LIGHT = (3.5, 3.0, 2.3)
KEY_SPREAD = 0.17  # radius over distance of the key light: width of its shadows' edges
RIM = (0.7276, 0.5457, 0.4157)  # a cool window behind, to the right
SKY, HORIZON, BOUNCE = (0.40, 0.52, 0.78), (0.34, 0.34, 0.38), (0.20, 0.11, 0.05)
COLOR_TOLERANCE = 2e-4  # scene units; a hundredth of a pixel at 200 x 200


@compiled
def ambient(nx, ny, nz):
    """Light of sky and table on a surface of normal n (no key light), linear."""
    up = 0.5 + 0.5 * nz
    rim = max(0.35 + 0.65 * (nx * RIM[0] + ny * RIM[1] + nz * RIM[2]), 0.0)
    a, b, c = up * up, 2.0 * up * (1.0 - up), (1.0 - up) * (1.0 - up)
    return (
        a * SKY[0] + b * HORIZON[0] + c * BOUNCE[0] + 0.16 * rim,
        a * SKY[1] + b * HORIZON[1] + c * BOUNCE[1] + 0.24 * rim,
        a * SKY[2] + b * HORIZON[2] + c * BOUNCE[2] + 0.42 * rim,
    )


@compiled
def surroundings(dx, dy, dz, roughness):
    """Environment seen by a reflection that hits no solid: sky, the key light's soft box, the rim window."""
    up = smoothstep(-0.25, 0.9, dz)
    soft = 0.012 + 0.28 * roughness
    key = dx * KEY[0] + dy * KEY[1] + dz * KEY[2]
    box = smoothstep(0.962 - soft, 0.962 + 0.25 * soft, key) * 9.0 / (1.0 + 22.0 * roughness * roughness)
    rim = dx * RIM[0] + dy * RIM[1] + dz * RIM[2]
    pane = smoothstep(0.955 - soft, 0.955 + 0.25 * soft, rim) * 3.0 / (1.0 + 12.0 * roughness * roughness)
    return (
        0.30 + 0.28 * up + 1.0 * box + 0.62 * pane,
        0.27 + 0.38 * up + 0.92 * box + 0.80 * pane,
        0.25 + 0.62 * up + 0.78 * box + 1.0 * pane,
    )


@compiled
def reflected(scene, seed, x, y, z, nx, ny, nz, dx, dy, dz, roughness):
    """Light arriving along the mirror direction: another solid, shaded without shadows, or the environment."""
    facing = dx * nx + dy * ny + dz * nz
    rx, ry, rz = dx - 2.0 * facing * nx, dy - 2.0 * facing * ny, dz - 2.0 * facing * nz
    away = surroundings(rx, ry, rz, roughness)
    if roughness > 0.3:
        return away
    ox, oy, oz = x + 0.004 * nx, y + 0.004 * ny, z + 0.004 * nz
    t, k = nearest_hit(scene, ox, oy, oz, rx, ry, rz, 0.0, 2.5, 1e-3)
    if k < 0:
        return away
    px, py, pz = ox + t * rx, oy + t * ry, oz + t * rz
    kinds, poses, params, _ = scene
    lx, ly, lz = to_local(poses[k], px, py, pz)
    red, green, blue, _, _, _, glow = surface(kinds[k], params[k], lx, ly, lz, seed)
    mx, my, mz = normal_at(scene, k, px, py, pz)
    key = 0.6 * max(mx * KEY[0] + my * KEY[1] + mz * KEY[2], 0.0)
    sky = ambient(mx, my, mz)
    return (
        red * (0.75 * sky[0] + key * KEY_LIGHT[0] + glow),
        green * (0.75 * sky[1] + key * KEY_LIGHT[1] + glow),
        blue * (0.75 * sky[2] + key * KEY_LIGHT[2] + glow),
    )


@compiled
def lit(scene, seed, k, x, y, z, dx, dy, dz):
    """Linear color of solid k at a world point seen along unit direction d."""
    kinds, poses, params, _ = scene
    lx, ly, lz = to_local(poses[k], x, y, z)
    red, green, blue, specular, roughness, metal, glow = surface(kinds[k], params[k], lx, ly, lz, seed)
    if kinds[k] == shapes.FLAME:
        return red * glow, green * glow, blue * glow
    nx, ny, nz = normal_at(scene, k, x, y, z)
    room = openness(scene, x, y, z, nx, ny, nz)
    key = max(nx * KEY[0] + ny * KEY[1] + nz * KEY[2], 0.0)
    if key > 0.0:
        key *= soft_shadow(
            scene, x + 0.003 * nx, y + 0.003 * ny, z + 0.003 * nz, KEY[0], KEY[1], KEY[2], 3.0, KEY_SPREAD
        )
    sky = ambient(nx, ny, nz)
    cosine = max(-(nx * dx + ny * dy + nz * dz), 0.0)
    grazing = (1.0 - cosine) ** 5
    strength = (specular + (1.0 - specular) * grazing * (1.0 - roughness)) * min(room + 0.25 * key, 1.0)
    mirror = reflected(scene, seed, x, y, z, nx, ny, nz, dx, dy, dz, roughness)
    plain = (1.0 - metal) * (1.0 - strength)
    tint_r, tint_g, tint_b = 1.0 - metal + metal * red, 1.0 - metal + metal * green, 1.0 - metal + metal * blue
    strength = strength + 0.45 * metal
    return (
        plain * red * (sky[0] * room + key * KEY_LIGHT[0] + glow) + strength * tint_r * mirror[0],
        plain * green * (sky[1] * room + key * KEY_LIGHT[1] + 0.75 * glow) + strength * tint_g * mirror[1],
        plain * blue * (sky[2] * room + key * KEY_LIGHT[2] + 0.4 * glow) + strength * tint_b * mirror[2],
    )


@compiled
def toned(value, exposure):
    """Filmic tone curve of one linear channel -> display-linear 0..1 (Narkowicz's fit of the ACES curve)."""
    x = max(value * exposure, 0.0)
    return min(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 1.0)


@compiled
def sampled(scene, seed, exposure, lens, pose, column, row):
    """Toned color and hit solid of the ray through image position (column, row), pixels; -1: background."""
    cx, cy = (column - lens[2]) / lens[0], (row - lens[3]) / lens[1]
    dx = pose[0, 0] * cx + pose[0, 1] * cy + pose[0, 2]
    dy = pose[1, 0] * cx + pose[1, 1] * cy + pose[1, 2]
    dz = pose[2, 0] * cx + pose[2, 1] * cy + pose[2, 2]
    scale = 1.0 / sqrt(dx * dx + dy * dy + dz * dz)
    dx, dy, dz = dx * scale, dy * scale, dz * scale
    ox, oy, oz = pose[0, 3], pose[1, 3], pose[2, 3]
    t, k = nearest_hit(scene, ox, oy, oz, dx, dy, dz, 0.0, MISS, COLOR_TOLERANCE)
    if k < 0:
        return 0.0, 0.0, 0.0, -1
    r, g, b = lit(scene, seed, k, ox + t * dx, oy + t * dy, oz + t * dz, dx, dy, dz)
    return toned(r, exposure), toned(g, exposure), toned(b, exposure), k


@compiled
def averaged(scene, seed, exposure, lens, pose, column, row, side):
    """Box-filtered pixel from side x side samples: (r, g, b premultiplied, coverage, uneven).

    uneven: the samples hit different solids or their brightness differs by more than 0.1.
    """
    red, green, blue, hits = 0.0, 0.0, 0.0, 0
    low, high, first, mixed = 2.0, -1.0, -2, False
    for j in range(side):
        for i in range(side):
            x, y = column + (i + 0.5) / side, row + (j + 0.5) / side
            r, g, b, k = sampled(scene, seed, exposure, lens, pose, x, y)
            if first == -2:
                first = k
            mixed = mixed or k != first
            low, high = min(low, r + g + b), max(high, r + g + b)
            if k >= 0:
                red, green, blue, hits = red + r, green + g, blue + b, hits + 1
    share = 1.0 / (side * side)
    return red * share, green * share, blue * share, hits * share, mixed or high - low > 0.3


@compiled
def encoded(value):
    """Display-linear 0..1 -> sRGB-encoded 0..1."""
    if value <= 0.0031308:
        return 12.92 * max(value, 0.0)
    return 1.055 * min(value, 1.0) ** (1.0 / 2.4) - 0.055


@released
def shade_rows(scene, seed, exposure, lens, pose, first_row, out, side, fine_side):
    """Fill out [rows, width, 4] (straight sRGB-encoded color, coverage) for the rows from first_row on.

    lens: (fx, fy, cx, cy) pixels; pose [4, 4] world_from_camera. Each pixel is the mean of side^2 samples, of
    fine_side^2 where those are uneven.
    """
    for j in range(out.shape[0]):
        for i in range(out.shape[1]):
            for grid in (side, max(side, fine_side)):
                r, g, b, a, uneven = averaged(scene, seed, exposure, lens, pose, i, first_row + j, grid)
                straight = 1.0 / max(a, 1e-9)
                color = (r * straight, g * straight, b * straight)
                for channel in range(3):
                    out[j, i, channel] = encoded(color[channel])
                out[j, i, 3] = a
                if not uneven:
                    break
