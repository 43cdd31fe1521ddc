"""Rendered buffers as pictures to look at."""

import numpy as np
from scipy.ndimage import map_coordinates

from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.cameras import Camera
from stylerf.rendering.view import RenderedView


def depth_picture(z: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Return planar depth [h, w] in viridis by inverse depth, near bright: [h, w, 3] uint8, black where empty."""
    from stylerf.environment.matplotlib_defaults import colormaps

    seen = (alpha > 0.5) & (z > 0)
    inverse = np.where(seen, 1 / np.maximum(z, 1e-6), 0)
    low, high = np.percentile(inverse[seen], [1, 99]) if seen.any() else (0.0, 1.0)
    level = np.clip((inverse - low) / max(high - low, 1e-9), 0, 1)
    colors = colormaps["viridis"](level)[..., :3] * seen[..., None]
    return (colors * 255 + 0.5).astype(np.uint8)


def displacement_picture(field: RadianceField, camera: Camera, seen: RenderedView) -> np.ndarray:
    """Return the displacement |D| of each pixel's surface in magma, black for none: [h, w, 3] uint8.

    The scale ends at the 99th percentile of visible surfaces.
    """
    from stylerf.environment.matplotlib_defaults import colormaps

    origins, directions = camera.rays()
    points = field.space.warp(origins + directions * seen.ray_distance.reshape(-1, 1))
    grid = field.displacement
    places = (points * (np.array(grid.shape[:3]) - 1)).T
    moved = np.stack([map_coordinates(grid[..., axis], places, order=1) for axis in range(3)], -1)
    far = np.linalg.norm(moved, axis=1).reshape(seen.alpha.shape) * (seen.alpha > 0.5)
    most = max(float(np.percentile(far[seen.alpha > 0.5], 99)) if (seen.alpha > 0.5).any() else 0.0, 1e-9)
    return (colormaps["magma"](np.clip(far / most, 0, 1))[..., :3] * 255 + 0.5).astype(np.uint8)


def sheet_of(rows: list[list[np.ndarray]], beside: np.ndarray, gap: int = 6) -> np.ndarray:
    """Arrange pictures [h, w, 3] of one size in rows beside one as tall as all rows, at the left; 0..1, on white."""
    height, width = rows[0][0].shape[:2]
    tall = len(rows) * (height + gap) - gap
    wide = round(beside.shape[1] * tall / beside.shape[0])
    sheet = np.ones((tall, wide + len(rows[0]) * (width + gap), 3), np.float32)
    down = np.arange(tall) * beside.shape[0] // tall
    across = np.arange(wide) * beside.shape[1] // wide
    sheet[:, :wide] = beside[down[:, None], across[None, :], :3]
    for i, row in enumerate(rows):
        for j, picture in enumerate(row):
            top, left = i * (height + gap), wide + gap + j * (width + gap)
            sheet[top : top + height, left : left + width] = picture[..., :3]
    return sheet
