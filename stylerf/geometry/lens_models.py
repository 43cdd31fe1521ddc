"""Lens models other than Brown's and Kannala-Brandt's, in COLMAP's parametrization: undistorted to distorted points.

p: parameters after the focal lengths and the principal point. x, y: undistorted (X/Z, Y/Z); r^2 = x^2 + y^2.
"""

from collections.abc import Callable

import numpy as np

Formula = Callable[[np.ndarray, tuple[float, ...]], np.ndarray]
_CENTER = 1e-9  # below this radius, a ratio of radii equals its limit up to rounding


def fov(points: np.ndarray, p: tuple[float, ...]) -> np.ndarray:
    """Devernay and Faugeras 2001: r' = atan(2 r tan(w/2)) / w."""
    (w,) = p
    if abs(w) < _CENTER:
        return points
    r = _radius(points)
    slope = 2 * np.tan(w / 2)
    return points * np.where(r > _CENTER, np.arctan(r * slope) / (np.maximum(r, _CENTER) * w), slope / w)


def fov_inverse(points: np.ndarray, p: tuple[float, ...]) -> np.ndarray:
    """r = tan(w r') / (2 tan(w/2)); NaN for w r' >= 90 degrees."""
    (w,) = p
    if abs(w) < _CENTER:
        return points
    r = _radius(points)
    slope = 2 * np.tan(w / 2)
    inverse = points * np.where(r > _CENTER, np.tan(r * w) / (np.maximum(r, _CENTER) * slope), w / slope)
    return np.where(np.abs(r * w) < np.pi / 2, inverse, np.nan)


def division(points: np.ndarray, p: tuple[float, ...]) -> np.ndarray:
    """Fitzgibbon 2001: r = r' / (1 + k r'^2), so r' = 2 r / (1 + sqrt(1 - 4 k r^2)); NaN where there is no root."""
    (k,) = p
    root = 1 - 4 * k * _radius(points) ** 2
    return points * (2 / (1 + np.sqrt(np.where(root >= 0, root, np.nan))))


def division_inverse(points: np.ndarray, p: tuple[float, ...]) -> np.ndarray:
    """The inverse of division(): a denominator of 0 means 90 degrees off the axis, a negative one is behind it."""
    (k,) = p
    scale = 1 + k * _radius(points) ** 2
    return points / np.where(scale > _CENTER, scale, np.nan)


def eucm(points: np.ndarray, p: tuple[float, ...]) -> np.ndarray:
    """Khomutenko et al. 2016, eq. 9: (x, y) / (alpha sqrt(beta r^2 + 1) + 1 - alpha)."""
    alpha, beta = p
    return points / (alpha * np.sqrt(beta * _radius(points) ** 2 + 1) + 1 - alpha)


def eucm_inverse(points: np.ndarray, p: tuple[float, ...]) -> np.ndarray:
    """Khomutenko et al. 2016, eq. 15; NaN where the ray leaves the front half-space."""
    alpha, beta = p
    squared = _radius(points) ** 2
    root = 1 - (2 * alpha - 1) * beta * squared
    z = (1 - beta * alpha**2 * squared) / (alpha * np.sqrt(np.maximum(root, 0)) + 1 - alpha)
    return points / np.where((root >= 0) & (z > _CENTER), z, np.nan)


def thin_prism_fisheye(points: np.ndarray, p: tuple[float, ...]) -> np.ndarray:
    """Weng et al. 1992 on equidistant points (u, v) = (x, y) atan(r)/r, with s^2 = u^2 + v^2.

    p: k1, k2, p1, p2, k3, k4, sx1, sy1. u' = u (1 + k1 s^2 + ... + k4 s^8) + 2 p1 u v + p2 (s^2 + 2 u^2) + sx1 s^2,
    v' likewise with p1 and p2 swapped and sy1.
    """
    k1, k2, p1, p2, k3, k4, sx1, sy1 = p
    flat = _equidistant(points)
    u, v = flat[..., 0], flat[..., 1]
    s = u * u + v * v
    radial = 1 + s * (k1 + s * (k2 + s * (k3 + s * k4)))
    return np.stack(
        [
            u * radial + 2 * p1 * u * v + p2 * (s + 2 * u * u) + sx1 * s,
            v * radial + 2 * p2 * u * v + p1 * (s + 2 * v * v) + sy1 * s,
        ],
        axis=-1,
    )


def rad_tan_thin_prism_fisheye(points: np.ndarray, p: tuple[float, ...]) -> np.ndarray:
    """Project Aria's Fisheye624: radial in the angle, then tangential, then thin prism.

    p: k0 to k5, p0, p1, s0 to s3. (u, v) = (x, y) a (1 + k0 a^2 + ... + k5 a^12) / r with a = atan(r), s = u^2 + v^2;
    u' = u + p0 (2 u^2 + s) + 2 p1 u v + s0 s + s1 s^2, v' = v + p1 (2 v^2 + s) + 2 p0 u v + s2 s + s3 s^2.
    """
    *k, p0, p1, s0, s1, s2, s3 = p
    flat = _equidistant(points)
    squared = (flat * flat).sum(axis=-1, keepdims=True)
    radial = np.zeros_like(squared)
    for coefficient in reversed(k):
        radial = (radial + coefficient) * squared
    flat = flat * (1 + radial)
    u, v = flat[..., 0], flat[..., 1]
    s = u * u + v * v
    return np.stack(
        [
            u + p0 * (2 * u * u + s) + 2 * p1 * u * v + s * (s0 + s * s1),
            v + p1 * (2 * v * v + s) + 2 * p0 * u * v + s * (s2 + s * s3),
        ],
        axis=-1,
    )


def tangent_of(points: np.ndarray, p: tuple[float, ...]) -> np.ndarray:
    """Initial guess of Newton's method for fisheyes: r' is nearly the angle, bounded below 90 degrees."""
    r = _radius(points)
    return points * np.where(r > _CENTER, np.tan(np.minimum(r, 1.45)) / np.maximum(r, _CENTER), 1.0)


def _radius(points: np.ndarray) -> np.ndarray:
    return np.linalg.norm(points, axis=-1, keepdims=True)


def _equidistant(points: np.ndarray) -> np.ndarray:
    r = _radius(points)
    return points * np.where(r > _CENTER, np.arctan(r) / np.maximum(r, _CENTER), 1.0)


# By kind: the formula, the initial guess of its inverse (exact or close), and the number of parameters.
LENSES: dict[str, tuple[Formula, Formula, int]] = {
    "fov": (fov, fov_inverse, 1),
    "division": (division, division_inverse, 1),
    "eucm": (eucm, eucm_inverse, 2),
    "thin_prism_fisheye": (thin_prism_fisheye, tangent_of, 8),
    "rad_tan_thin_prism_fisheye": (rad_tan_thin_prism_fisheye, tangent_of, 12),
}
