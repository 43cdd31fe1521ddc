"""Downsample images by area averaging.

sRGB code values are averaged without decoding, as in all benchmarks of these scenes. Colors must be premultiplied, or
the colors of transparent pixels bleed into edges.
"""

import numpy as np


def shrunk(pixels: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Downsample [h, w, c] float32 to size (width, height) by area averaging.

    For integer factors, each pixel is the mean of its block; otherwise pixels are weighted by the covered area.
    """
    height, width = pixels.shape[:2]
    if (width, height) == tuple(size):
        return pixels
    if height % size[1] == 0 and width % size[0] == 0:
        ky, kx = height // size[1], width // size[0]
        return pixels.reshape(size[1], ky, size[0], kx, -1).mean(axis=(1, 3), dtype=np.float32)
    lower = _averaged(pixels, *_area_weights(height, size[1]), axis=0)
    return np.ascontiguousarray(_averaged(lower, *_area_weights(width, size[0]), axis=1))


def _area_weights(many: int, few: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the pixels that each new pixel overlaps, and their weights, which add up to 1; [few, n] each."""
    edges = np.arange(few + 1) * (many / few)
    low, high = edges[:-1, None], edges[1:, None]
    # One more than the ratio, since a new pixel need not begin at the edge of an old one.
    cells = np.floor(low).astype(int) + np.arange(int(np.ceil(many / few)) + 1)
    overlap = np.clip(np.minimum(high, cells + 1) - np.maximum(low, cells), 0, None)
    return np.minimum(cells, many - 1), (overlap / overlap.sum(axis=1, keepdims=True)).astype(np.float32)


def _averaged(pixels: np.ndarray, cells: np.ndarray, weights: np.ndarray, axis: int) -> np.ndarray:
    shape = [1, 1, 1]
    shape[axis] = -1
    parts = zip(cells.T, weights.T, strict=True)
    total, *rest = (np.take(pixels, index, axis=axis) * weight.reshape(shape) for index, weight in parts)
    for part in rest:
        total += part
    return total


def nearest(values: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Resample [h, w, ...] to size (width, height) with nearest-neighbor interpolation."""
    rows = ((np.arange(size[1]) + 0.5) * (values.shape[0] / size[1])).astype(int)
    columns = ((np.arange(size[0]) + 0.5) * (values.shape[1] / size[0])).astype(int)
    return values[rows][:, columns]
