"""The box that holds an object, from its silhouettes: a coarse visual hull that never cuts the object."""

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.geometry.cameras import Camera

CELLS = 64
# Cells kept free around the hull at the last, finest level.
MARGIN_CELLS = 3
_LONGEST_SIDE = 256
# Share of silhouettes that may miss a part of the object before the box follows them: masks fail in single views.
_FAULTY_SHARE = 0.02
# Share of views that must judge a point: behind the object, out of the others' sight, a few views rule out nothing.
_SHOWING_SHARE = 0.2
_VIEWS_OF_FIRST_LEVELS = 20


def silhouette(alpha: np.ndarray, threshold: float = 0.02) -> np.ndarray:
    """Where there is any object: [h, w] 0..1 -> bool, sides at most 256, each pixel the largest of its block."""
    factor = _factor(*alpha.shape)
    height, width = (-(-side // factor) for side in alpha.shape)
    padded = np.zeros((height * factor, width * factor), bool)
    padded[: alpha.shape[0], : alpha.shape[1]] = alpha > threshold
    return padded.reshape(height, factor, width, factor).any(axis=(1, 3))


def _factor(height: int, width: int) -> int:
    return max(1, -(-max(height, width) // _LONGEST_SIDE))


def hull_box(cameras: list[Camera], silhouettes: list[np.ndarray], box: np.ndarray, levels: int = 3) -> np.ndarray:
    """[2, 3] box of the cells that (nearly) no view sees as empty, starting from a box [2, 3] that holds the object.

    A cell is empty for a view where its whole footprint falls on background. What a view does not show it can rule out
    only if its silhouette is clear of the border; each cell must be judged by a fifth of the views.
    Each level divides the box of the one before into CELLS^3.
    InvalidValue where nothing is left: the silhouettes and the poses contradict one another.
    """
    for level in range(levels):
        size = (box[1] - box[0]) / CELLS
        # Fewer views give a larger hull: good enough until the last level, and most of the time saved.
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
    """[CELLS, CELLS, CELLS] bool by axes x, y, z."""
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
        # A ball of this radius around the center holds the cell; nearer parts of it look larger than its center does.
        slope = (pixels * factor - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
        oblique = np.sqrt(1 + (slope * slope).sum(-1))
        reach = max(camera.fx, camera.fy) / factor * radius * oblique / np.where(front, depth - radius, 1.0)
        limit = np.array([camera.width, camera.height]) / factor
        inside = front & (pixels >= reach[:, None]).all(1) & (pixels <= limit - reach[:, None]).all(1)
        # A silhouette clear of the picture's border is the whole object: then what is out of sight is empty too.
        whole = not (mask[0].any() or mask[-1].any() or mask[:, 0].any() or mask[:, -1].any())
        judged = front if whole else inside
        empty = depth < -radius if whole else np.zeros(len(alive), bool)
        empty[judged] = ~_any_within(table, pixels[judged], reach[judged])
        seen[alive[judged | empty]] += 1
        against[alive[empty]] += 1
        alive = alive[against[alive] <= allowed]
    kept = np.zeros(len(centers), bool)
    enough = seen[alive] >= max(1, len(cameras) * _SHOWING_SHARE)
    kept[alive] = enough & (against[alive] <= seen[alive] * _FAULTY_SHARE)
    return kept.reshape(CELLS, CELLS, CELLS)


def _summed(mask: np.ndarray) -> np.ndarray:
    """[h + 1, w + 1] int64: how many pixels are set above and left of each corner."""
    return np.pad(mask.astype(np.int64).cumsum(0).cumsum(1), ((1, 0), (1, 0)))


def _any_within(table: np.ndarray, pixels: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Whether any pixel is set in the square of +- reach [n] around positions [n, 2], from a table of _summed."""
    height, width = table.shape[0] - 1, table.shape[1] - 1
    low = np.floor(pixels - reach[:, None]).clip(0, [width, height]).astype(int)
    high = np.ceil(pixels + reach[:, None]).clip(0, [width, height]).astype(int)
    (left, top), (right, bottom) = low.T, high.T
    return table[bottom, right] - table[top, right] - table[bottom, left] + table[top, left] > 0
