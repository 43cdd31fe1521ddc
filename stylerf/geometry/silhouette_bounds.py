"""The bounding box of an object from its silhouettes, by a coarse, conservative visual hull."""

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.geometry.cameras import Camera

CELLS = 64
MARGIN_CELLS = 3  # around the hull, at the finest level
_LONGEST_SIDE = 256
_FAULTY_SHARE = 0.02  # fraction of silhouettes that may miss part of the object, since masks fail in single views
_SHOWING_SHARE = 0.2  # fraction of views that must judge a cell: few views cannot rule out what others do not see
_VIEWS_OF_FIRST_LEVELS = 20


def silhouette(alpha: np.ndarray, threshold: float = 0.02) -> np.ndarray:
    """Threshold alpha [h, w] and downsample it to sides of at most 256; a block is set if any pixel is; bool."""
    factor = _factor(*alpha.shape)
    height, width = (-(-side // factor) for side in alpha.shape)
    padded = np.zeros((height * factor, width * factor), bool)
    padded[: alpha.shape[0], : alpha.shape[1]] = alpha > threshold
    return np.asarray(padded.reshape(height, factor, width, factor).any(axis=(1, 3)))


def _factor(height: int, width: int) -> int:
    return max(1, -(-max(height, width) // _LONGEST_SIDE))


def hull_box(cameras: list[Camera], silhouettes: list[np.ndarray], box: np.ndarray, levels: int = 3) -> np.ndarray:
    """Return the bounding box [2, 3] of the object's visual hull.

    A view rules out a cell if the cell's entire footprint is background. Cells outside the image are ruled out only if
    the silhouette does not touch the border. A cell is kept if a fifth of the views judge it and almost none rule it
    out.

    Args:
        cameras: The views.
        silhouettes: One per view, from silhouette().
        box: [2, 3], a box that contains the object.
        levels: Number of refinements; each divides the previous box into CELLS^3.

    Raises:
        InvalidValue: No cell is left, because silhouettes and poses are inconsistent.
    """
    for level in range(levels):
        size = (box[1] - box[0]) / CELLS
        # Fewer views give a larger hull, which is faster and good enough before the last level.
        stride = 1 if level == levels - 1 else max(1, len(cameras) // _VIEWS_OF_FIRST_LEVELS)
        kept = _kept(cameras[::stride], silhouettes[::stride], box, size)
        if not kept.any():
            raise InvalidValue("no point in space is covered by all silhouettes; check the poses and the masks")
        found = np.argwhere(kept)
        margin = MARGIN_CELLS if level == levels - 1 else 1
        low, high = box[0] + (found.min(0) - margin) * size, box[0] + (found.max(0) + 1 + margin) * size
        box = np.stack([np.maximum(low, box[0]), np.minimum(high, box[1])]) if level == 0 else np.stack([low, high])
    return box


def _kept(cameras: list[Camera], silhouettes: list[np.ndarray], box: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Return the cells of the hull, [CELLS, CELLS, CELLS] bool, axes x, y, z."""
    axes = [box[0, a] + (np.arange(CELLS) + 0.5) * size[a] for a in range(3)]
    centers = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    alive, allowed = np.arange(len(centers)), int(len(cameras) * _FAULTY_SHARE)
    seen, against = np.zeros(len(centers), np.int32), np.zeros(len(centers), np.int32)
    radius = float(np.linalg.norm(size)) / 2
    for camera, mask in zip(cameras, silhouettes, strict=True):
        table, factor = _summed(mask), _factor(camera.height, camera.width)
        pixels, depth = camera.project(centers[alive])
        pixels /= factor
        front = depth > 2 * radius
        # Project the cell's bounding sphere, whose nearer parts appear larger than its center.
        slope = (pixels * factor - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
        oblique = np.sqrt(1 + slope[:, 0] ** 2 + slope[:, 1] ** 2)
        reach = max(camera.fx, camera.fy) / factor * radius * oblique / np.where(front, depth - radius, 1.0)
        inside = front.copy()
        for axis, side in enumerate((camera.width, camera.height)):  # numpy is slow along an axis of two
            inside &= (pixels[:, axis] >= reach) & (pixels[:, axis] <= side / factor - reach)
        # A silhouette that does not touch the border is complete, so everything outside the image is also empty.
        whole = not (mask[0].any() or mask[-1].any() or mask[:, 0].any() or mask[:, -1].any())
        judged = front if whole else inside
        empty = depth < -radius if whole else np.zeros(len(alive), bool)
        empty[judged] = ~_any_within(table, pixels[judged], reach[judged])
        seen[alive[judged | empty]] += 1
        against[alive[empty]] += 1
        # Cells ruled out by more views than may be faulty need not be projected into later views.
        alive = alive[against[alive] <= allowed]
    kept = np.zeros(len(centers), bool)
    enough = seen[alive] >= max(1, len(cameras) * _SHOWING_SHARE)
    kept[alive] = enough & (against[alive] <= seen[alive] * _FAULTY_SHARE)
    return kept.reshape(CELLS, CELLS, CELLS)


def _summed(mask: np.ndarray) -> np.ndarray:
    """Return the summed-area table of a mask, [h + 1, w + 1] int64."""
    return np.pad(mask.astype(np.int64).cumsum(0).cumsum(1), ((1, 0), (1, 0)))


def _any_within(table: np.ndarray, pixels: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Return whether any pixel is set within +- reach [n] of positions [n, 2], given the summed-area table."""
    height, width = table.shape[0] - 1, table.shape[1] - 1
    (left, right), (top, bottom) = (
        (np.floor(at - reach).clip(0, side).astype(int), np.ceil(at + reach).clip(0, side).astype(int))
        for at, side in ((pixels[:, 0], width), (pixels[:, 1], height))
    )
    return np.asarray(table[bottom, right] - table[top, right] - table[bottom, left] + table[top, left] > 0)
