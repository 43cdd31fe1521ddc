"""Pictures to a smaller size: area averages.

Code values are averaged as they are (sRGB-encoded), as every benchmark of these scenes does. Colors must come
multiplied by alpha, else what lies under transparent pixels bleeds into edges.
"""

import numpy as np


def shrunk(pixels: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Area average of [h, w, c] float32 to size (width, height), not larger than the picture.

    At integer factors each pixel is the plain mean of its block; else borders of pixels count by the share covered.
    """
    height, width = pixels.shape[:2]
    if (width, height) == tuple(size):
        return pixels
    if height % size[1] == 0 and width % size[0] == 0:
        ky, kx = height // size[1], width // size[0]
        return pixels.reshape(size[1], ky, size[0], kx, -1).mean(axis=(1, 3), dtype=np.float32)
    lower = _averaged(pixels, *_area_taps(height, size[1]), axis=0)
    return np.ascontiguousarray(_averaged(lower, *_area_taps(width, size[0]), axis=1))


def _area_taps(many: int, few: int) -> tuple[np.ndarray, np.ndarray]:
    """cells, shares [few, taps]: the pixels under the interval of each new pixel, and their shares, summing to 1."""
    edges = np.arange(few + 1) * (many / few)
    low, high = edges[:-1, None], edges[1:, None]
    cells = np.floor(low).astype(int) + np.arange(int(np.ceil(many / few)) + 1)
    overlap = np.clip(np.minimum(high, cells + 1) - np.maximum(low, cells), 0, None)
    return np.minimum(cells, many - 1), (overlap / overlap.sum(axis=1, keepdims=True)).astype(np.float32)


def _averaged(pixels: np.ndarray, cells: np.ndarray, shares: np.ndarray, axis: int) -> np.ndarray:
    shape = [1, 1, 1]
    shape[axis] = -1
    total = 0
    for taps, weights in zip(cells.T, shares.T, strict=True):
        total = total + np.take(pixels, taps, axis=axis) * weights.reshape(shape)
    return total


def nearest(values: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """[h, w, ...] sampled at the pixel that each center of the picture of `size` (width, height) falls into."""
    rows = ((np.arange(size[1]) + 0.5) * (values.shape[0] / size[1])).astype(int)
    columns = ((np.arange(size[0]) + 0.5) * (values.shape[1] / size[0])).astype(int)
    return values[rows][:, columns]
