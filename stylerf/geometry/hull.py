"""The box that holds an object, from its silhouettes: a coarse visual hull that never cuts the object."""

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.geometry.cameras import Camera

CELLS = 64
# Cells kept free around the hull at the last, finest level.
MARGIN_CELLS = 3
_LONGEST_SIDE = 128


def silhouette(alpha: np.ndarray, threshold: float = 0.02) -> np.ndarray:
    """Where there is any object: [h, w] 0..1 -> bool, sides at most 128, each pixel the largest of its block."""
    factor = max(1, -(-max(alpha.shape) // _LONGEST_SIDE))
    height, width = (-(-side // factor) for side in alpha.shape)
    padded = np.zeros((height * factor, width * factor), bool)
    padded[: alpha.shape[0], : alpha.shape[1]] = alpha > threshold
    return padded.reshape(height, factor, width, factor).any(axis=(1, 3))


def hull_box(cameras: list[Camera], silhouettes: list[np.ndarray], box: np.ndarray, levels: int = 3) -> np.ndarray:
    """[2, 3] box of the cells that no view sees as empty, starting from a box [2, 3] that holds the object.

    A cell is empty for a view where its whole footprint falls on background; what a view does not show it cannot rule
    out, but each cell must be shown by at least one. Each level divides the box of the one before into CELLS^3.
    InvalidValue where nothing is left: the silhouettes and the poses contradict one another.
    """
    for level in range(levels):
        size = (box[1] - box[0]) / CELLS
        kept = _kept(cameras, silhouettes, box, size)
        if not kept.any():
            raise InvalidValue("no point in space is covered by all silhouettes; check the poses and the masks")
        found = np.argwhere(kept)
        margin = MARGIN_CELLS if level == levels - 1 else 1
        low, high = box[0] + (found.min(0) - margin) * size, box[0] + (found.max(0) + 1 + margin) * size
        box = np.stack([np.maximum(low, box[0]), np.minimum(high, box[1])]) if level == 0 else np.stack([low, high])
    return box


def _kept(cameras: list[Camera], silhouettes: list[np.ndarray], box: np.ndarray, size: np.ndarray) -> np.ndarray:
    """[CELLS, CELLS, CELLS] bool by axes x, y, z."""
    axes = [box[0, a] + (np.arange(CELLS) + 0.5) * size[a] for a in range(3)]
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    alive, seen = np.arange(len(centres)), np.zeros(len(centres), bool)
    radius = float(np.linalg.norm(size)) / 2
    for camera, mask in zip(cameras, silhouettes, strict=True):
        shrink = np.array([mask.shape[1] / camera.width, mask.shape[0] / camera.height])
        # Padding of the last block makes this a little small; a pixel of tolerance is added to every footprint.
        pixels, depth = camera.project(centres[alive])
        pixels *= shrink
        front = depth > radius
        reach = np.where(front, max(camera.fx, camera.fy) * shrink.max() * radius / np.where(front, depth, 1.0), 0) + 1
        inside = front & (pixels >= reach[:, None]).all(1) & (pixels <= np.array(mask.shape[::-1]) - reach[:, None]).all(1)
        if not inside.any():
            continue
        widest = int(np.ceil(reach[inside].max()))
        covered = _dilated(mask, widest)
        cell = pixels[inside].astype(int)
        empty = np.zeros(len(alive), bool)
        empty[inside] = ~covered[cell[:, 1], cell[:, 0]]
        seen[alive[inside]] = True
        alive = alive[~empty]
    kept = np.zeros(len(centres), bool)
    kept[alive] = seen[alive]
    return kept.reshape(CELLS, CELLS, CELLS)


def _dilated(mask: np.ndarray, radius: int) -> np.ndarray:
    """Each pixel the largest of the square of +- radius around it."""
    for axis in (0, 1):
        padding = [(0, 0), (0, 0)]
        padding[axis] = (radius, radius)
        padded = np.pad(mask, padding)
        # A running count tells whether the window holds any object in one pass, whatever its length.
        count = np.cumsum(np.insert(padded.astype(np.int32), 0, 0, axis=axis), axis=axis)
        length = 2 * radius + 1
        upper = np.take(count, np.arange(length, length + mask.shape[axis]), axis=axis)
        mask = upper > np.take(count, np.arange(mask.shape[axis]), axis=axis)
    return mask
