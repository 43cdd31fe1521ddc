"""Bytes of the photos, in memory or mapped from a file, and which of their pixels to draw more often."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_cdt

STRETCH = 65536  # bytes that reading one byte of a mapped file may load (Linux maps 16 pages around it)


def psnr_from_mse(mse: float) -> float:
    """-10 log10(mse), dB, for values in 0..1."""
    return -10.0 * math.log10(max(mse, 1e-12))


@dataclass(frozen=True, eq=False)
class Pixels:
    """Photos one after another, row-major: values uint8 [sum of h w channels], with straight alpha for 4 channels.

    values may be mapped from a file: `read` is called with the number of places read since, each of which may have
    loaded up to STRETCH bytes, and releases what is too much.
    """

    values: np.ndarray
    channels: int
    read: Callable[[int], None] = lambda places: None

    @classmethod
    def of(cls, images: list[np.ndarray]) -> "Pixels":
        """Copy uint8 images [h, w, 3 or 4] of equal channels into one array."""
        return cls(np.concatenate([image.reshape(-1) for image in images]), images[0].shape[2])


class LitPixels:
    """Pixels near anything opaque, indexed 0, 1, ... in the order of views, rows and columns.

    Stored as runs: for 300 images of an object megabytes, where an index per pixel would take gigabytes.
    """

    def __init__(self, alphas: Iterator[np.ndarray]) -> None:
        """alphas: [h, w] of every view in turn."""
        begins, lengths, before = [], [], 0
        for alpha in alphas:
            edges = np.diff(near_opaque(alpha).ravel().astype(np.int8), prepend=0, append=0)
            rising = np.flatnonzero(edges == 1)
            begins.append(before + rising)
            lengths.append(np.flatnonzero(edges == -1) - rising)
            before += alpha.size
        self._begins = np.concatenate(begins)
        # For each run, what to add to an index within it, and the first index after it.
        self._after = np.cumsum(np.concatenate(lengths))
        self._shifts = self._begins - np.concatenate([[0], self._after[:-1]])[: len(self._begins)]

    def below(self, pixel: int) -> int:
        """Number of them in the views before `pixel`, the first pixel of a view."""
        runs = int(np.searchsorted(self._begins, pixel))
        return int(self._after[runs - 1]) if runs else 0

    def __getitem__(self, numbers: np.ndarray) -> np.ndarray:
        """The pixels of these indices."""
        return numbers + self._shifts[np.searchsorted(self._after, numbers, side="right")]


def near_opaque(alpha: np.ndarray) -> np.ndarray:
    """Pixels with alpha over 0, and those within 2 % of the height (at least 2 pixels) of them, bool [h, w]."""
    if not alpha.any():
        return np.zeros(alpha.shape, bool)
    # The taxicab distance equals repeated dilation by a cross, in two passes.
    return distance_transform_cdt(alpha == 0, metric="taxicab") <= max(2, alpha.shape[0] // 50)
