"""Repeatable lattice noise, compiled: the same point and seed give the same value on every machine."""

from math import floor

from stylerf.procedural import compiled


@compiled
def lattice(i, j, k, seed):
    """A value in [0, 1) for an integer lattice point: 32-bit multiplicative hash kept inside int64."""
    h = (i * 374761393 + j * 668265263 + k * 1440662683 + seed * 974711) & 0xFFFFFFFF
    h = ((h ^ (h >> 13)) * 1274126177) & 0xFFFFFFFF
    h = ((h ^ (h >> 16)) * 1103515245) & 0xFFFFFFFF
    return (h ^ (h >> 15)) / 4294967296.0


@compiled
def noise(x, y, z, seed):
    """Smooth value noise in [0, 1) with unit lattice: quintic blend of the eight corners."""
    fx, fy, fz = floor(x), floor(y), floor(z)
    i, j, k = int(fx), int(fy), int(fz)
    u, v, w = x - fx, y - fy, z - fz
    u = u * u * u * (u * (6.0 * u - 15.0) + 10.0)
    v = v * v * v * (v * (6.0 * v - 15.0) + 10.0)
    w = w * w * w * (w * (6.0 * w - 15.0) + 10.0)
    a = lattice(i, j, k, seed) * (1 - u) + lattice(i + 1, j, k, seed) * u
    b = lattice(i, j + 1, k, seed) * (1 - u) + lattice(i + 1, j + 1, k, seed) * u
    c = lattice(i, j, k + 1, seed) * (1 - u) + lattice(i + 1, j, k + 1, seed) * u
    d = lattice(i, j + 1, k + 1, seed) * (1 - u) + lattice(i + 1, j + 1, k + 1, seed) * u
    return (a * (1 - v) + b * v) * (1 - w) + (c * (1 - v) + d * v) * w


@compiled
def fractal(x, y, z, octaves, seed):
    """Sum of `octaves` octaves of noise, each half as strong and twice as fine; in [0, 1)."""
    total, weight, norm = 0.0, 0.5, 0.0
    for octave in range(octaves):
        total += weight * noise(x, y, z, seed + octave)
        norm += weight
        weight *= 0.5
        x, y, z = 2.03 * x + 17.1, 2.03 * y + 5.3, 2.03 * z + 9.7  # off-lattice so that octaves do not line up
    return total / norm


@compiled
def smoothstep(low, high, x):
    """0 below low, 1 above high, a cubic between."""
    t = min(max((x - low) / (high - low), 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)
