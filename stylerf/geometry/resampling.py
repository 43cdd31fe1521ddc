"""Pictures to a smaller size: area averages.

Code values are averaged as they are (sRGB-encoded), as every benchmark of these scenes does. Colours must come
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
    rows, columns = _area_weights(height, size[1]), _area_weights(width, size[0])
    lower = np.einsum("ab,bwc->awc", rows, pixels, optimize=True)
    return np.ascontiguousarray(np.einsum("dw,awc->adc", columns, lower, optimize=True), dtype=np.float32)


def _area_weights(many: int, few: int) -> np.ndarray:
    """[few, many] float32: share of pixel j in the interval of pixel i, each row summing to 1."""
    edges = np.arange(few + 1) * (many / few)
    low, high = edges[:-1, None], edges[1:, None]
    cell = np.arange(many)[None]
    overlap = np.clip(np.minimum(high, cell + 1) - np.maximum(low, cell), 0, None)
    return (overlap / overlap.sum(axis=1, keepdims=True)).astype(np.float32)


def nearest(values: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """[h, w, ...] sampled at the pixel that each centre of the picture of `size` (width, height) falls into."""
    rows = ((np.arange(size[1]) + 0.5) * (values.shape[0] / size[1])).astype(int)
    columns = ((np.arange(size[0]) + 0.5) * (values.shape[1] / size[0])).astype(int)
    return values[rows][:, columns]
