"""Sphere tracing of a list of solids, compiled: nearest hit, normals, soft shadows and ambient occlusion.

A scene is a tuple of arrays over its n solids (see `pack` in solids.py):
    kinds [n] int64, poses [n, 12] (rows of the world-from-local rotation, then the translation),
    params [n, 4], boxes [n, 6] (lower and upper corner of the solid's local bounding box).
A ray is first intersected with each solid's bounding box and then stepped against that solid alone, which is several
times cheaper than stepping against the union.
"""

from math import sqrt

import numpy as np

from stylerf.procedural import compiled, released
from stylerf.procedural.shapes import DISC, FLAME, shape_distance

MISS = 1e9  # distance reported inside the kernels for "nothing hit"; infinities are not allowed under fastmath


@compiled
def to_local(pose, x, y, z):
    """World point -> local point of a solid: R^T (p - t)."""
    x, y, z = x - pose[9], y - pose[10], z - pose[11]
    return (
        pose[0] * x + pose[3] * y + pose[6] * z,
        pose[1] * x + pose[4] * y + pose[7] * z,
        pose[2] * x + pose[5] * y + pose[8] * z,
    )


@compiled
def turn_local(pose, x, y, z):
    """World direction -> local direction of a solid: R^T d."""
    return (
        pose[0] * x + pose[3] * y + pose[6] * z,
        pose[1] * x + pose[4] * y + pose[7] * z,
        pose[2] * x + pose[5] * y + pose[8] * z,
    )


@compiled
def slab(low, high, origin, direction, near, far):
    """The part of [near, far] in which one coordinate of a ray is between low and high."""
    if abs(direction) < 1e-12:
        return (near, far) if low <= origin <= high else (1.0, 0.0)
    a, b = (low - origin) / direction, (high - origin) / direction
    return max(near, min(a, b)), min(far, max(a, b))


@compiled
def box_span(bounds, margin, ox, oy, oz, dx, dy, dz, near, far):
    """The part of [near, far] in which a local ray is in a solid's box, enlarged by `margin`; empty if near > far."""
    near, far = slab(bounds[0] - margin, bounds[3] + margin, ox, dx, near, far)
    if near > far:
        return near, far
    near, far = slab(bounds[1] - margin, bounds[4] + margin, oy, dy, near, far)
    if near > far:
        return near, far
    return slab(bounds[2] - margin, bounds[5] + margin, oz, dz, near, far)


@compiled
def nearest_hit(scene, ox, oy, oz, dx, dy, dz, near, far, tolerance):
    """First surface along a ray with unit direction: (distance, index of the solid), or (MISS, -1).

    A hit is where the distance function falls below `tolerance` (scene units); at most 256 steps per solid.
    """
    kinds, poses, params, boxes = scene
    best, owner = far, -1
    for k in range(kinds.shape[0]):
        lx, ly, lz = to_local(poses[k], ox, oy, oz)
        ux, uy, uz = turn_local(poses[k], dx, dy, dz)
        t, end = box_span(boxes[k], 0.0, lx, ly, lz, ux, uy, uz, near, best)
        for _ in range(256):
            if t > end:
                break
            d = shape_distance(kinds[k], params[k], lx + t * ux, ly + t * uy, lz + t * uz)
            if d < tolerance:
                best, owner = t, k
                break
            t += d
    return (best, owner) if owner >= 0 else (MISS, -1)


@compiled
def scene_distance(scene, x, y, z, far):
    """Distance from a world point to the nearest solid, or `far` where all are farther."""
    kinds, poses, params, boxes = scene
    best = far
    for k in range(kinds.shape[0]):
        lx, ly, lz = to_local(poses[k], x, y, z)
        b = boxes[k]
        gx = max(b[0] - lx, lx - b[3], 0.0)
        gy = max(b[1] - ly, ly - b[4], 0.0)
        gz = max(b[2] - lz, lz - b[5], 0.0)
        if gx * gx + gy * gy + gz * gz < best * best or best < 0.0:
            best = min(best, shape_distance(kinds[k], params[k], lx, ly, lz))
    return best


@compiled
def normal_at(scene, k, x, y, z):
    """Unit outward normal of solid k at a world point: differences on a tetrahedron, rotated to world space."""
    kinds, poses, params, _ = scene
    lx, ly, lz = to_local(poses[k], x, y, z)
    h = 4e-4
    a = shape_distance(kinds[k], params[k], lx + h, ly - h, lz - h)
    b = shape_distance(kinds[k], params[k], lx - h, ly - h, lz + h)
    c = shape_distance(kinds[k], params[k], lx - h, ly + h, lz - h)
    d = shape_distance(kinds[k], params[k], lx + h, ly + h, lz + h)
    nx, ny, nz = a - b - c + d, -a - b + c + d, -a + b - c + d
    p = poses[k]
    wx = p[0] * nx + p[1] * ny + p[2] * nz
    wy = p[3] * nx + p[4] * ny + p[5] * nz
    wz = p[6] * nx + p[7] * ny + p[8] * nz
    scale = 1.0 / max(sqrt(wx * wx + wy * wy + wz * wz), 1e-12)
    return wx * scale, wy * scale, wz * scale


@compiled
def soft_shadow(scene, x, y, z, dx, dy, dz, far, spread):
    """Visible fraction of an area light, 0..1, from how close a ray passes to solids relative to the light's cone.

    spread: radius of the light over its distance. A ray through a solid's center gives 0, one that clears it by the
    cone's radius gives 1; noise-free and independent of the view. The table casts no shadow (all lights are above it),
    nor does the flame.
    """
    kinds, poses, params, boxes = scene
    seen = 1.0
    margin = 0.6 * spread
    for k in range(kinds.shape[0]):
        if kinds[k] in (DISC, FLAME):
            continue
        lx, ly, lz = to_local(poses[k], x, y, z)
        ux, uy, uz = turn_local(poses[k], dx, dy, dz)
        t, end = box_span(boxes[k], margin, lx, ly, lz, ux, uy, uz, 0.01, far)
        for _ in range(48):
            if t > end:
                break
            d = shape_distance(kinds[k], params[k], lx + t * ux, ly + t * uy, lz + t * uz)
            seen = min(seen, 0.5 + 0.5 * d / (spread * t))
            if seen <= 0.0:
                return 0.0
            t += min(max(abs(d), 0.012), 0.12)
    return seen * seen * (3.0 - 2.0 * seen)


@compiled
def openness(scene, x, y, z, nx, ny, nz):
    """Ambient light that reaches a point, 0..1, from the free space along the normal at five distances."""
    blocked, weight, h = 0.0, 1.0, 0.025
    for _ in range(5):
        d = scene_distance(scene, x + h * nx, y + h * ny, z + h * nz, h)
        blocked += weight * max(h - d, 0.0) / h
        weight *= 0.72
        h *= 1.9
    return max(1.0 - 0.42 * blocked, 0.0)


@released
def trace_rays(scene, origins, directions, tolerance):
    """Distances [n] float64 along rays (origins, unit directions [n, 3] float64) and solids hit [n]; MISS and -1."""
    count = origins.shape[0]
    distances, owners = np.empty(count), np.empty(count, np.int64)
    for i in range(count):
        o, d = origins[i], directions[i]
        distances[i], owners[i] = nearest_hit(scene, o[0], o[1], o[2], d[0], d[1], d[2], 0.0, MISS, tolerance)
    return distances, owners


@released
def point_distances(scene, points):
    """Distance [n] of world points [n, 3] to the nearest solid, negative inside."""
    out = np.empty(points.shape[0])
    for i in range(points.shape[0]):
        out[i] = scene_distance(scene, points[i, 0], points[i, 1], points[i, 2], MISS)
    return out
