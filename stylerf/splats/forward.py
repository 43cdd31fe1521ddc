"""Render splats with spherical harmonics up to degree 3, in bounded memory."""

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.geometry.cameras import Camera
from stylerf.geometry.spherical_harmonics import C0, harmonics
from stylerf.kernels.cpu.simd_splats import TILE
from stylerf.kernels.cpu.splats import SCREEN, Gaussians, project
from stylerf.splats.rasterizer import draw_projected, splat_camera

CHUNK = 1 << 18  # splats whose colors are computed at once
PAIR_BYTES = 16  # per pair of a tile and an overlapping splat: the rasterizer's lists, and building them
DEGREES = {1: 0, 4: 1, 9: 2, 16: 3}  # by number of bands


def picture(
    gaussians: Gaussians, camera: Camera, *, near: float, threads: int, most_bytes: int = 1 << 30
) -> np.ndarray:
    """Render splats as in 3D Gaussian splatting, without a background.

    If there are too many overlapping splats for the memory, the image is rendered in bands of rows, with the same
    result.

    Args:
        gaussians: n splats with 1, 4, 9 or 16 bands of harmonics.
        camera: The camera, scene units.
        near: Minimum depth of a splat's center, scene units.
        threads: Number of threads; the result does not depend on it.
        most_bytes: Maximum memory of the lists of overlaps between splats and tiles.

    Returns:
        [height, width, 4] float32, rgb premultiplied by alpha and sRGB-encoded, alpha 0..1. Splat colors are bounded
        below by 0 and unbounded above.

    Raises:
        InvalidValue: A single row of tiles needs more memory.
    """
    plain = gaussians._replace(harmonics=((colors(gaussians, camera) - 0.5) / C0)[:, None])
    n = len(gaussians.centers)
    screen, depths = np.empty((n, SCREEN), np.float32), np.empty(n, np.float32)
    boxes = np.empty((n, 4), np.int32)
    project(plain, splat_camera(camera, near), threads, screen, depths, boxes)
    bands = _bands(boxes, camera.height, most_bytes // PAIR_BYTES)
    parts = [
        draw_projected(*_shifted(screen, boxes, top, end), depths, camera.width, end - top, threads)[0]
        for top, end in bands
    ]
    return np.concatenate(parts, axis=0)


def colors(gaussians: Gaussians, camera: Camera) -> np.ndarray:
    """Return the colors [n, 3] float32 of splats seen from a camera: 1/2 + sum_b Y_b(d) harmonics_b."""
    degree = DEGREES[gaussians.harmonics.shape[1]]
    found = np.empty((len(gaussians.centers), 3), np.float32)
    for start in range(0, len(found), CHUNK):
        part = slice(start, start + CHUNK)
        ways = gaussians.centers[part] - camera.center.astype(np.float32)
        ways /= np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1e-12)
        found[part] = 0.5 + np.einsum("nb,nbc->nc", _basis(ways, degree), gaussians.harmonics[part])
    return found


def _basis(ways: np.ndarray, degree: int) -> np.ndarray:
    if degree < 3:
        return harmonics(ways, degree)
    x, y, z = ways.T
    # Degree 3 with the signs of 3D Gaussian splatting, from Sloan 2013, appendix A2.
    third = [
        -0.5900435899266435 * y * (3 * x * x - y * y),
        2.890611442640554 * x * y * z,
        -0.4570457994644658 * y * (5 * z * z - 1),
        0.3731763325901154 * z * (5 * z * z - 3),
        -0.4570457994644658 * x * (5 * z * z - 1),
        1.445305721320277 * z * (x * x - y * y),
        -0.5900435899266435 * x * (x * x - 3 * y * y),
    ]
    return np.column_stack([harmonics(ways, 2), *third]).astype(np.float32)


def _bands(boxes: np.ndarray, height: int, most: int) -> list[tuple[int, int]]:
    """Divide the image's rows into bands with at most `most` pairs of tiles and splats."""
    seen = boxes[boxes[:, 1] > boxes[:, 0]]
    rows = -(-height // TILE)
    across = (seen[:, 1] - seen[:, 0]).astype(np.float64)
    # Per row of tiles: every splat adds its width at its first row and subtracts it after its last.
    steps = np.bincount(seen[:, 2] // TILE, across, rows + 1)
    steps -= np.bincount((seen[:, 3] - 1) // TILE + 1, across, rows + 1)
    found, top, held = [], 0, 0.0
    for row, pairs in enumerate(np.cumsum(steps)[:rows]):
        if pairs > most:
            raise InvalidValue(f"{pairs:.0f} splats reach a single row of tiles, more than memory holds")
        if held + pairs > most:
            found.append((top * TILE, row * TILE))
            top, held = row, 0.0
        held += pairs
    return [*found, (top * TILE, height)]


def _shifted(screen: np.ndarray, boxes: np.ndarray, top: int, end: int) -> tuple[np.ndarray, np.ndarray]:
    """Return `screen` and `boxes` clipped to rows `top` to `end`, relative to `top`."""
    screen, boxes = screen.copy(), boxes.copy()
    screen[:, 1] -= top
    boxes[:, 2:] = (boxes[:, 2:] - top).clip(0, end - top)
    boxes[boxes[:, 3] <= boxes[:, 2]] = 0
    return screen, boxes
