"""Bytes of the photos, in memory or mapped from a file, and which of their pixels to draw more often."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_cdt

STRETCH = 65536  # bytes that a look at one byte of a mapped file can bring into memory (Linux maps 16 pages around it)


def psnr_from_mse(mse: float) -> float:
    """-10 log10(mse), dB, for values in 0..1."""
    return -10.0 * math.log10(max(mse, 1e-12))


@dataclass(frozen=True, eq=False)
class Pixels:
    """Photos one after another, row-major: values uint8 [sum of h w channels], straight alpha where channels is 4.

    values may be mapped from elsewhere, a part of it in memory at a time: `read` is told at how many places it has been
    looked at since, each with up to STRETCH bytes around it, and lets go of what is too much.
    """

    values: np.ndarray
    channels: int
    read: Callable[[int], None] = lambda places: None

    @classmethod
    def of(cls, images: list[np.ndarray]) -> "Pixels":
        """uint8 [h, w, 3 or 4] each, all with as many channels, copied into one array."""
        return cls(np.concatenate([image.reshape(-1) for image in images]), images[0].shape[2])


class LitPixels:
    """The pixels near anything opaque, by their numbers 0, 1, ... in the order of views, rows and columns.

    Kept as runs: those of 300 pictures of an object take megabytes, where one number a pixel takes gigabytes.
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
        # For each run, what to add to a number among its pixels, and the first number after it.
        self._after = np.cumsum(np.concatenate(lengths))
        self._shifts = self._begins - np.concatenate([[0], self._after[:-1]])[: len(self._begins)]

    def below(self, pixel: int) -> int:
        """How many lie in the views before `pixel`, the first of a view."""
        runs = int(np.searchsorted(self._begins, pixel))
        return int(self._after[runs - 1]) if runs else 0

    def __getitem__(self, numbers: np.ndarray) -> np.ndarray:
        """The pixels of these numbers."""
        return numbers + self._shifts[np.searchsorted(self._after, numbers, side="right")]


def near_opaque(alpha: np.ndarray) -> np.ndarray:
    """bool [h, w]: pixels with alpha over 0, and those up to 2 % of the height (2 at least) steps beside them."""
    if not alpha.any():
        return np.zeros(alpha.shape, bool)
    # So many steps along rows and columns: what as many rounds of dilation by a cross reach, in two passes.
    return distance_transform_cdt(alpha == 0, metric="taxicab") <= max(2, alpha.shape[0] // 50)
