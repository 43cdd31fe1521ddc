"""Tile-based splatting of anisotropic 3D Gaussians, and its backward pass (Zwicker et al. 2001; Kerbl et al. 2023).

A Gaussian with center m, scales s and rotation R has covariance R diag(s)^2 R^T. In a camera with rotation W, its
image is a Gaussian with covariance

    C = J W R diag(s)^2 R^T W^T J^T + BLUR I,   J the Jacobian of the projection at m

and its opacity at an offset d from its center is alpha = o exp(-d^T C^-1 d / 2), clamped to LARGEST_ALPHA; below
SMALLEST_ALPHA it is skipped. Pixels are composited front to back, by the depth of the centers, until the transmittance
is below LEAST_TRANSMITTANCE.

Tiles are as wide as a vector. Each pair of a tile and a Gaussian has its own gradients, which are summed per Gaussian
in tile order, so results do not depend on the number of threads.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import inline, parallel_kernel, serial_kernel
from stylerf.kernels.cpu.simd_splats import (
    LEAST_TRANSMITTANCE,
    PAIR,
    PIXELS,
    SMALLEST_ALPHA,
    TILE,
    blend_row,
    blend_row_backward,
    row_total,
)


class Gaussians(NamedTuple):
    """3D Gaussians, all float32.

    Attributes:
        centers: [n, 3], scene units.
        log_scales: [n, 3], natural logarithms of the standard deviations, scene units.
        quaternions: [n, 4], w x y z, of any nonzero length: rotation of the axes that the scales refer to.
        logits: [n], of the opacity.
        harmonics: [n, bands, 3]: color = max(0, 1/2 + sum_b Y_b(d) harmonics_b), sRGB-encoded.
    """

    centers: np.ndarray
    log_scales: np.ndarray
    quaternions: np.ndarray
    logits: np.ndarray
    harmonics: np.ndarray


class SplatCamera(NamedTuple):
    """A camera in the kernels' format.

    Attributes:
        pose: [12] float32, camera_from_world: rotation (row-major), translation.
        numbers: [7] float32: fx, fy, cx, cy, pixels; the camera's center, scene units.
        width, height: pixels.
        near: minimum depth of a Gaussian's center, scene units.
    """

    pose: np.ndarray
    numbers: np.ndarray
    width: int
    height: int
    near: np.float32


BLUR = np.float32(0.3)  # pixels^2: no projected Gaussian is narrower than a pixel
BEYOND = np.float32(0.15)  # of the image's side: J is clamped this far outside the image, where it would explode
SCREEN = 10  # values of a projected Gaussian: x, y, inverse covariance xx, xy, yy, opacity, red, green, blue, -
_LEAST_ALPHA, _LEAST_LEFT = np.float32(SMALLEST_ALPHA), np.float32(LEAST_TRANSMITTANCE)
_ZERO, _HALF, _ONE, _TWO = np.float32(0), np.float32(0.5), np.float32(1), np.float32(2)
_C0, _C1 = np.float32(0.28209479177387814), np.float32(0.4886025119029199)
_C2A, _C2B, _C2C = np.float32(1.0925484305920792), np.float32(0.31539156525252005), np.float32(0.5462742152960396)


@inline
def _rotation(q):
    """Return the 3x3 rotation of a unit quaternion (w, x, y, z), row-major."""
    w, x, y, z = q
    return (
        _ONE - _TWO * (y * y + z * z), _TWO * (x * y - w * z), _TWO * (x * z + w * y),
        _TWO * (x * y + w * z), _ONE - _TWO * (x * x + z * z), _TWO * (y * z - w * x),
        _TWO * (x * z - w * y), _TWO * (y * z + w * x), _ONE - _TWO * (x * x + y * y),
    )  # fmt: skip


@inline
def _unit(quaternions, i):
    w, x, y, z = quaternions[i, 0], quaternions[i, 1], quaternions[i, 2], quaternions[i, 3]
    length = np.float32(math.sqrt(w * w + x * x + y * y + z * z))
    scale = _ONE / max(length, np.float32(1e-12))
    return w * scale, x * scale, y * scale, z * scale, scale


@inline
def _basis(x, y, z):
    """Return spherical harmonics up to degree 2, in the order of geometry/spherical_harmonics.py."""
    return (
        _C0, -_C1 * y, _C1 * z, -_C1 * x, _C2A * x * y, -_C2A * y * z, _C2B * (np.float32(3) * z * z - _ONE),
        -_C2A * x * z, _C2C * (x * x - y * y),
    )  # fmt: skip


@inline
def _in_camera(centers, i, pose):
    """Return the position in camera space; pose [12]: camera_from_world, rotation (row-major), then translation."""
    x, y, z = centers[i, 0], centers[i, 1], centers[i, 2]
    return (
        pose[0] * x + pose[1] * y + pose[2] * z + pose[9],
        pose[3] * x + pose[4] * y + pose[5] * z + pose[10],
        pose[6] * x + pose[7] * y + pose[8] * z + pose[11],
    )


@inline
def _axes(log_scales, i, r, pose, j00, j02, j11, j12):
    """Return the rows [3] of J W R diag(s), whose inner products are the image covariance."""
    s0 = np.float32(math.exp(log_scales[i, 0]))
    s1 = np.float32(math.exp(log_scales[i, 1]))
    s2 = np.float32(math.exp(log_scales[i, 2]))
    # T = J W
    t0, t1, t2 = j00 * pose[0] + j02 * pose[6], j00 * pose[1] + j02 * pose[7], j00 * pose[2] + j02 * pose[8]
    u0, u1, u2 = j11 * pose[3] + j12 * pose[6], j11 * pose[4] + j12 * pose[7], j11 * pose[5] + j12 * pose[8]
    return (
        (t0 * r[0] + t1 * r[3] + t2 * r[6]) * s0,
        (t0 * r[1] + t1 * r[4] + t2 * r[7]) * s1,
        (t0 * r[2] + t1 * r[5] + t2 * r[8]) * s2,
        (u0 * r[0] + u1 * r[3] + u2 * r[6]) * s0,
        (u0 * r[1] + u1 * r[4] + u2 * r[7]) * s1,
        (u0 * r[2] + u1 * r[5] + u2 * r[8]) * s2,
        (t0, t1, t2, u0, u1, u2),
        (s0, s1, s2),
    )


@parallel_kernel
def project(gaussians, camera, threads, screen, depths, boxes):
    """Project Gaussians: screen-space values, depths, and bounding boxes.

    Args:
        gaussians: see Gaussians.
        camera: see SplatCamera.
        screen: output, [n, SCREEN].
        depths: output, [n]: along the viewing axis.
        boxes: output, [n, 4] int32: first and last tile column, first and last pixel row, last ones exclusive; all 0 if
            not visible.
    """
    centers, log_scales, quaternions = gaussians.centers, gaussians.log_scales, gaussians.quaternions
    logits, harmonics = gaussians.logits, gaussians.harmonics
    pose, numbers, near = camera.pose, camera.numbers, camera.near
    width, height = camera.width, camera.height
    fx, fy, cx, cy = numbers[0], numbers[1], numbers[2], numbers[3]
    ox, oy, oz = numbers[4], numbers[5], numbers[6]
    n, bands = len(centers), harmonics.shape[1]
    left, right = (-BEYOND * width - cx) / fx, ((_ONE + BEYOND) * width - cx) / fx
    above, below = (-BEYOND * height - cy) / fy, ((_ONE + BEYOND) * height - cy) / fy
    for thread in prange(threads):
        for i in range(thread * n // threads, (thread + 1) * n // threads):
            boxes[i, 0], boxes[i, 1], boxes[i, 2], boxes[i, 3] = 0, 0, 0, 0
            x, y, z = _in_camera(centers, i, pose)
            depths[i] = z
            if not z > near:
                continue
            opacity = _ONE / (_ONE + np.float32(math.exp(-logits[i])))
            if not opacity > _LEAST_ALPHA:
                continue
            u, v = min(max(x / z, left), right), min(max(y / z, above), below)
            qw, qx, qy, qz, _ = _unit(quaternions, i)
            r = _rotation((qw, qx, qy, qz))
            a0, a1, a2, b0, b1, b2, _, _ = _axes(log_scales, i, r, pose, fx / z, -fx * u / z, fy / z, -fy * v / z)
            cxx = a0 * a0 + a1 * a1 + a2 * a2 + BLUR
            cxy = a0 * b0 + a1 * b1 + a2 * b2
            cyy = b0 * b0 + b1 * b1 + b2 * b2 + BLUR
            determinant = cxx * cyy - cxy * cxy
            px, py = fx * x / z + cx, fy * y / z + cy
            # alpha falls to its minimum where the exponent is -ln(o / _LEAST_ALPHA): bounding box of that ellipse.
            reach = _TWO * np.float32(math.log(opacity / _LEAST_ALPHA))
            across, down = np.float32(math.sqrt(reach * cxx)), np.float32(math.sqrt(reach * cyy))
            if not (determinant > _ZERO and px + across > _ZERO and px - across < width):
                continue
            if not (py + down > _ZERO and py - down < height):
                continue
            first = int(max(_ZERO, px - across)) // TILE
            last = int(min(np.float32(width - 1), px + across)) // TILE + 1
            top = int(max(_ZERO, math.floor(py - down)))
            bottom = int(min(np.float32(height - 1), py + down)) + 1
            boxes[i, 0], boxes[i, 1], boxes[i, 2], boxes[i, 3] = first, last, top, bottom
            scale = _ONE / determinant
            screen[i, 0], screen[i, 1] = px, py
            screen[i, 2], screen[i, 3], screen[i, 4] = cyy * scale, -cxy * scale, cxx * scale
            screen[i, 5] = opacity
            dx, dy, dz = centers[i, 0] - ox, centers[i, 1] - oy, centers[i, 2] - oz
            length = np.float32(math.sqrt(dx * dx + dy * dy + dz * dz))
            basis = _basis(dx / length, dy / length, dz / length)
            for channel in range(3):
                color = _HALF
                for band in range(bands):
                    color += basis[band] * harmonics[i, band, channel]
                screen[i, 6 + channel] = max(color, _ZERO)


@serial_kernel
def sort_by_depth(depths, boxes, order, spare):
    """Write the visible Gaussians to order[:count], nearest first; return count. Stable.

    Radix sort of the bits of positive float32 numbers, which sort like the numbers. order, spare: [n] int32.
    """
    count = 0
    for i in range(len(boxes)):
        if boxes[i, 1] > boxes[i, 0]:
            order[count] = i
            count += 1
    bits = depths.view(np.int32)
    places = np.empty(2048, np.int64)
    one, other = order, spare
    for shift in (0, 11, 22):
        places[:] = 0
        for k in range(count):
            places[(bits[one[k]] >> shift) & 2047] += 1
        at = 0
        for digit in range(2048):
            number = places[digit]
            places[digit] = at
            at += number
        for k in range(count):
            digit = (bits[one[k]] >> shift) & 2047
            other[places[digit]] = one[k]
            places[digit] += 1
        one, other = other, one
    for k in range(count):
        order[k] = one[k]
    return count


@serial_kernel
def count_pairs(boxes, order, count, tiles_across, tile_ends, first_pairs):
    """Count pairs per tile, to tile_ends [tiles + 1], and per visible Gaussian, to first_pairs [count + 1]."""
    tile_ends[:] = 0
    total = 0
    for k in range(count):
        i = order[k]
        first_pairs[k] = total
        for row in range(boxes[i, 2] // TILE, (boxes[i, 3] - 1) // TILE + 1):
            for column in range(boxes[i, 0], boxes[i, 1]):
                tile_ends[row * tiles_across + column + 1] += 1
                total += 1
    first_pairs[count] = total
    for tile in range(1, len(tile_ends)):
        tile_ends[tile] += tile_ends[tile - 1]
    return total


@serial_kernel
def fill_pairs(boxes, order, count, tiles_across, tile_ends, members, places):
    """List the Gaussians of each tile, nearest first, in members [pairs]; places [pairs]: each pair's index in it.

    On entry, tile_ends holds starts; afterwards, tile t's members are tile_ends[t - 1]:tile_ends[t], starting at 0.
    """
    pair = 0
    for k in range(count):
        i = order[k]
        for row in range(boxes[i, 2] // TILE, (boxes[i, 3] - 1) // TILE + 1):
            for column in range(boxes[i, 0], boxes[i, 1]):
                tile = row * tiles_across + column
                at = tile_ends[tile]
                tile_ends[tile] += 1
                members[at] = i
                places[pair] = at
                pair += 1


@parallel_kernel
def blend(screen, boxes, tile_ends, members, tiles_across, threads, out):
    """Composite tiles front to back: out [tiles, 4, PIXELS], premultiplied red, green, blue, and transmittance."""
    tiles = out.shape[0]
    for thread in prange(threads):
        s = np.empty(4 * PIXELS, np.float32)
        for tile in range(thread, tiles, threads):
            start = tile_ends[tile - 1] if tile > 0 else 0
            end = tile_ends[tile]
            row0, column0 = tile // tiles_across * TILE, tile % tiles_across * TILE
            for p in range(3 * PIXELS):
                s[p] = _ZERO
            for p in range(3 * PIXELS, 4 * PIXELS):
                s[p] = _ONE
            for k in range(start, end):
                i = members[k]
                mx, a, b = screen[i, 0] - np.float32(column0) - _HALF, screen[i, 2], screen[i, 3]
                c, opacity = screen[i, 4], screen[i, 5]
                red, green, blue, half_a = screen[i, 6], screen[i, 7], screen[i, 8], _HALF * a
                top, bottom = max(boxes[i, 2] - row0, 0), min(boxes[i, 3] - row0, TILE)
                for row in range(top, bottom):
                    dy = np.float32(row0 + row) + _HALF - screen[i, 1]
                    constant, slope = -_HALF * c * dy * dy, b * dy
                    at = row * TILE
                    blend_row(s, at, mx, constant, slope, half_a, opacity, red, green, blue)
                if (k - start) % 16 == 15:
                    most = _ZERO
                    for p in range(3 * PIXELS, 4 * PIXELS):
                        most = max(most, s[p])
                    if most < _LEAST_LEFT:
                        break
            for channel in range(4):
                for p in range(PIXELS):
                    out[tile, channel, p] = s[channel * PIXELS + p]


@parallel_kernel
def blend_backward(screen, boxes, tile_ends, members, tiles_across, out, gradients, threads, sums):
    """Compute the sums of each pair, sums [pairs, PAIR], from out and dL/d(red, green, blue, alpha) [tiles, 4, PIXELS].

    With D_k = g . (c_k, 1) for the k-th Gaussian of a pixel, g = dL/d(pixel) and weights w_k = T_k alpha_k:

        dL/d(alpha_k) = T_k D_k - sum_{j>k} w_j D_j / (1 - alpha_k)
    """
    tiles = out.shape[0]
    for thread in prange(threads):
        # Planes: 0-3 g, 4 transmittance, 5 sum behind; then PAIR vectors of sums.
        s = np.empty(6 * PIXELS + PAIR * TILE, np.float32)
        acc = 6 * PIXELS
        for tile in range(thread, tiles, threads):
            start = tile_ends[tile - 1] if tile > 0 else 0
            end = tile_ends[tile]
            row0, column0 = tile // tiles_across * TILE, tile % tiles_across * TILE
            for p in range(PIXELS):
                behind = gradients[tile, 3, p] * (_ONE - out[tile, 3, p])
                s[3 * PIXELS + p] = gradients[tile, 3, p]
                for channel in range(3):
                    s[channel * PIXELS + p] = gradients[tile, channel, p]
                    behind += gradients[tile, channel, p] * out[tile, channel, p]
                s[4 * PIXELS + p] = _ONE
                s[5 * PIXELS + p] = behind
            ended = False
            for k in range(start, end):
                if ended:
                    for q in range(PAIR):
                        sums[k, q] = _ZERO
                    continue
                i = members[k]
                mx, a, b = screen[i, 0] - np.float32(column0) - _HALF, screen[i, 2], screen[i, 3]
                c, opacity = screen[i, 4], screen[i, 5]
                red, green, blue, half_a = screen[i, 6], screen[i, 7], screen[i, 8], _HALF * a
                top, bottom = max(boxes[i, 2] - row0, 0), min(boxes[i, 3] - row0, TILE)
                for q in range(PAIR * TILE):
                    s[acc + q] = _ZERO
                for row in range(top, bottom):
                    dy = np.float32(row0 + row) + _HALF - screen[i, 1]
                    constant, slope = -_HALF * c * dy * dy, b * dy
                    at = row * TILE
                    blend_row_backward(s, at, dy, mx, constant, slope, half_a, opacity, red, green, blue)
                for q in range(PAIR):
                    sums[k, q] = row_total(s, acc + q * TILE)
                if (k - start) % 16 == 15:
                    most = _ZERO
                    for p in range(4 * PIXELS, 5 * PIXELS):
                        most = max(most, s[p])
                    ended = bool(most < _LEAST_LEFT)


@parallel_kernel
def project_backward(gaussians, camera, screen, order, count, first_pairs, places, sums, threads, gradients):
    """Compute the gradients of visible Gaussians from the pairs' sums; those of others are unchanged.

    gradients: output, in the format of `gaussians`.
    """
    centers, log_scales, quaternions = gaussians.centers, gaussians.log_scales, gaussians.quaternions
    harmonics = gaussians.harmonics
    to_centers, to_scales, to_quaternions = gradients.centers, gradients.log_scales, gradients.quaternions
    to_logits, to_harmonics = gradients.logits, gradients.harmonics
    pose, numbers = camera.pose, camera.numbers
    width, height = camera.width, camera.height
    fx, fy, cx, cy = numbers[0], numbers[1], numbers[2], numbers[3]
    ox, oy, oz = numbers[4], numbers[5], numbers[6]
    bands = harmonics.shape[1]
    left, right = (-BEYOND * width - cx) / fx, ((_ONE + BEYOND) * width - cx) / fx
    above, below = (-BEYOND * height - cy) / fy, ((_ONE + BEYOND) * height - cy) / fy
    for thread in prange(threads):
        for k in range(thread * count // threads, (thread + 1) * count // threads):
            i = order[k]
            g0, g1, g2, g3, g4, g5 = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
            red, green, blue = _ZERO, _ZERO, _ZERO
            for pair in range(first_pairs[k], first_pairs[k + 1]):
                at = places[pair]
                g0 += sums[at, 0]
                g1 += sums[at, 1]
                g2 += sums[at, 2]
                g3 += sums[at, 3]
                g4 += sums[at, 4]
                g5 += sums[at, 5]
                red += sums[at, 6]
                green += sums[at, 7]
                blue += sums[at, 8]
            a, b, c, opacity = screen[i, 2], screen[i, 3], screen[i, 4], screen[i, 5]
            # alpha = o exp(power), power = -(a dx^2 + c dy^2) / 2 - b dx dy; g0 = sum of alpha dL/d(alpha).
            to_logits[i] = g0 * (_ONE - opacity)
            at_x, at_y = a * g1 + b * g2, b * g1 + c * g2
            ga, gb, gc = -_HALF * g3, -_HALF * g4, -_HALF * g5  # as a symmetric matrix
            # dL/dC = -K G K for K = C^-1
            k00, k01, k10, k11 = a * ga + b * gb, a * gb + b * gc, b * ga + c * gb, b * gb + c * gc
            gxx, gxy, gyy = -(k00 * a + k01 * b), -(k00 * b + k01 * c), -(k10 * b + k11 * c)
            x, y, z = _in_camera(centers, i, pose)
            raw_u, raw_v = x / z, y / z
            u, v = min(max(raw_u, left), right), min(max(raw_v, above), below)
            qw, qx, qy, qz, per_length = _unit(quaternions, i)
            r = _rotation((qw, qx, qy, qz))
            j00, j02, j11, j12 = fx / z, -fx * u / z, fy / z, -fy * v / z
            a0, a1, a2, b0, b1, b2, t, s = _axes(log_scales, i, r, pose, j00, j02, j11, j12)
            # dL/d(axes) = 2 G axes
            da0, da1, da2 = _TWO * (gxx * a0 + gxy * b0), _TWO * (gxx * a1 + gxy * b1), _TWO * (gxx * a2 + gxy * b2)
            db0, db1, db2 = _TWO * (gxy * a0 + gyy * b0), _TWO * (gxy * a1 + gyy * b1), _TWO * (gxy * a2 + gyy * b2)
            # axes = T R diag(s): s dL/ds = axes . dL/d(axes)
            to_scales[i, 0] = a0 * da0 + b0 * db0
            to_scales[i, 1] = a1 * da1 + b1 * db1
            to_scales[i, 2] = a2 * da2 + b2 * db2
            da0, da1, da2, db0, db1, db2 = da0 * s[0], da1 * s[1], da2 * s[2], db0 * s[0], db1 * s[1], db2 * s[2]
            # dL/dR = T^T dL/d(axes) diag(s)
            r00, r01, r02 = t[0] * da0 + t[3] * db0, t[0] * da1 + t[3] * db1, t[0] * da2 + t[3] * db2
            r10, r11, r12 = t[1] * da0 + t[4] * db0, t[1] * da1 + t[4] * db1, t[1] * da2 + t[4] * db2
            r20, r21, r22 = t[2] * da0 + t[5] * db0, t[2] * da1 + t[5] * db1, t[2] * da2 + t[5] * db2
            dw = _TWO * (qx * (r21 - r12) + qy * (r02 - r20) + qz * (r10 - r01))
            dx = _TWO * (qy * (r01 + r10) + qz * (r02 + r20) + qw * (r21 - r12) - _TWO * qx * (r11 + r22))
            dy = _TWO * (qx * (r01 + r10) + qz * (r12 + r21) + qw * (r02 - r20) - _TWO * qy * (r00 + r22))
            dz = _TWO * (qx * (r02 + r20) + qy * (r12 + r21) + qw * (r10 - r01) - _TWO * qz * (r00 + r11))
            along = dw * qw + dx * qx + dy * qy + dz * qz
            to_quaternions[i, 0] = (dw - along * qw) * per_length
            to_quaternions[i, 1] = (dx - along * qx) * per_length
            to_quaternions[i, 2] = (dy - along * qy) * per_length
            to_quaternions[i, 3] = (dz - along * qz) * per_length
            # dL/dT = dL/d(axes) diag(s) R^T, dL/dJ = dL/dT W^T
            d00 = da0 * r[0] + da1 * r[1] + da2 * r[2]
            d01 = da0 * r[3] + da1 * r[4] + da2 * r[5]
            d02 = da0 * r[6] + da1 * r[7] + da2 * r[8]
            d10 = db0 * r[0] + db1 * r[1] + db2 * r[2]
            d11 = db0 * r[3] + db1 * r[4] + db2 * r[5]
            d12 = db0 * r[6] + db1 * r[7] + db2 * r[8]
            to_j00 = d00 * pose[0] + d01 * pose[1] + d02 * pose[2]
            to_j02 = d00 * pose[6] + d01 * pose[7] + d02 * pose[8]
            to_j11 = d10 * pose[3] + d11 * pose[4] + d12 * pose[5]
            to_j12 = d10 * pose[6] + d11 * pose[7] + d12 * pose[8]
            # Outside the limits, J is constant and only the center moves.
            at_u = at_x * fx - (to_j02 * fx / z if raw_u == u else _ZERO)
            at_v = at_y * fy - (to_j12 * fy / z if raw_v == v else _ZERO)
            px, py = at_u / z, at_v / z
            pz = -(at_u * raw_u + at_v * raw_v) / z
            pz += (-to_j00 * fx + to_j02 * fx * u - to_j11 * fy + to_j12 * fy * v) / (z * z)
            mx = pose[0] * px + pose[3] * py + pose[6] * pz
            my = pose[1] * px + pose[4] * py + pose[7] * pz
            mz = pose[2] * px + pose[5] * py + pose[8] * pz
            # Colors clamped at 0 have no gradient.
            red = red if screen[i, 6] > _ZERO else _ZERO
            green = green if screen[i, 7] > _ZERO else _ZERO
            blue = blue if screen[i, 8] > _ZERO else _ZERO
            vx, vy, vz = centers[i, 0] - ox, centers[i, 1] - oy, centers[i, 2] - oz
            length = np.float32(math.sqrt(vx * vx + vy * vy + vz * vz))
            basis = _basis(vx / length, vy / length, vz / length)
            for band in range(bands):
                to_harmonics[i, band, 0] = basis[band] * red
                to_harmonics[i, band, 1] = basis[band] * green
                to_harmonics[i, band, 2] = basis[band] * blue
            # The change of view direction with the center is neglected: scales are much smaller than distances.
            to_centers[i, 0], to_centers[i, 1], to_centers[i, 2] = mx, my, mz
