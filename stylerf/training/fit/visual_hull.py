"""Find cells outside an object's visual hull (Laurentini 1994), which cut-out photos show to be empty."""

from collections.abc import Iterable

import numpy as np

from stylerf.geometry.cameras import Camera
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.kernels.cpu.photos import count_clear

EMPTY = 8  # alpha, of 255, up to which a pixel counts as empty: compressed masks are noisy


def clear_cells(
    cameras: list[Camera], alphas: Iterable[np.ndarray], space: SpaceWarp, cells: int, share: float, threads: int
) -> np.ndarray:
    """Return [cells^3] bool: cells of a box cleared by at least `share` (0..1) of the views that see them, and by two.

    A view sees a cell that projects entirely into the image, and clears it if its alpha (uint8 [h, w]) is empty all
    over the cell's bounding ball and one pixel around it. A single wrong or truncated mask clears nothing.
    """
    corners = space.unwarp(np.array([[0.0, 0, 0], [1, 1, 1]]))
    low, width = corners[0].astype(np.float32), ((corners[1] - corners[0]) / cells).astype(np.float32)
    # The cell's bounding ball: its projection is easy to bound, and the larger volume only clears fewer cells.
    radius = np.float32(np.linalg.norm(width) / 2)
    seen, clear = np.zeros(cells**3, np.int32), np.zeros(cells**3, np.int32)
    for camera, alpha in zip(cameras, alphas):
        # Summed-area table: counting the opaque pixels of a rectangle takes four reads.
        sums = np.zeros((camera.height + 1, camera.width + 1), np.int32)
        np.cumsum(np.cumsum(alpha > EMPTY, 0, dtype=np.int32), 1, out=sums[1:, 1:])
        pose = np.ascontiguousarray(camera.world_from_camera[:3], np.float32)
        lens = (np.float32(v) for v in (camera.fx, camera.fy, camera.cx, camera.cy))
        count_clear(sums, pose, *lens, low, width, cells, radius, threads, seen, clear)
    return clear >= np.maximum(2, np.ceil(share * seen))
