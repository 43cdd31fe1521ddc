"""The training set: photos, in memory or mapped from a file, and random rays with their target colors."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_cdt

from stylerf.errors import InvalidValue
from stylerf.geometry.cameras import Camera
from stylerf.kernels.cpu.photos import Photos, gather
from stylerf.srgb import codes_at
from stylerf.training.common.even_draws import drawn_evenly

STRETCH = 65536  # bytes that reading one byte of a mapped file may load (Linux maps 16 pages around it)


def psnr_from_mse(mse: float) -> float:
    """Return -10 log10(mse), dB, for values in 0..1."""
    return -10.0 * math.log10(max(mse, 1e-12))  # at most 120 dB, so that an exact fit stays finite


@dataclass(frozen=True, eq=False)
class Pixels:
    """Concatenated photos, row-major: values uint8 [sum of h w channels], with straight alpha if there are 4 channels.

    values may be mapped from a file. `read` is called with the number of positions read since the last call, each of
    which may have loaded up to STRETCH bytes; it releases pages beyond its limit.
    """

    values: np.ndarray
    channels: int
    read: Callable[[int], None] = lambda places: None

    @classmethod
    def of(cls, images: list[np.ndarray]) -> "Pixels":
        """Copy uint8 images [h, w, 3 or 4], all with the same number of channels, into one array."""
        return cls(np.concatenate([image.reshape(-1) for image in images]), images[0].shape[2])


class LitPixels:
    """Pixels near anything not transparent, indexed 0, 1, ... by view, row and column.

    Stored as runs: 300 images of an object take megabytes, where an index per pixel would take gigabytes.
    """

    def __init__(self, alphas: Iterator[np.ndarray]) -> None:
        """alphas: [h, w] of each view in order."""
        begins, lengths, before = [], [], 0
        for alpha in alphas:
            # int8, since differences have signs. Padded per view, so that no run crosses into the next one (see
            # below()).
            edges = np.diff(near_opaque(alpha).ravel().astype(np.int8), prepend=0, append=0)
            rising = np.flatnonzero(edges == 1)
            begins.append(before + rising)
            lengths.append(np.flatnonzero(edges == -1) - rising)
            before += alpha.size
        self._begins = np.concatenate(begins)
        # For each run, the offset to add to an index within it, and the first index after it.
        self._after = np.cumsum(np.concatenate(lengths))
        self._shifts = self._begins - np.concatenate([[0], self._after[:-1]])[: len(self._begins)]

    def below(self, pixel: int) -> int:
        """Return how many are in the views before `pixel`, the first pixel of a view."""
        runs = int(np.searchsorted(self._begins, pixel))
        return int(self._after[runs - 1]) if runs else 0

    def __getitem__(self, numbers: np.ndarray) -> np.ndarray:
        """Return the pixels at these indices."""
        return numbers + self._shifts[np.searchsorted(self._after, numbers, side="right")]


def near_opaque(alpha: np.ndarray) -> np.ndarray:
    """Return [h, w] bool: pixels with nonzero alpha, and those within 2 % of the height (at least 2 pixels) of them."""
    if not alpha.any():
        return np.zeros(alpha.shape, bool)
    # A taxicab distance transform, two passes, equals repeated dilation by a cross.
    return distance_transform_cdt(alpha == 0, metric="taxicab") <= max(2, alpha.shape[0] // 50)


HIDDEN = 0.5  # maximum alpha of masked pixels in a capture's photo


def background_of(kind: str, count: int, generator: np.random.Generator | None) -> np.ndarray:
    """Return background colors [count, 3] float32; `random` is white without a generator."""
    if kind == "random" and generator is not None:
        return generator.random((count, 3), dtype=np.float32)
    level = 0.0 if kind in ("black", "none") else 1.0
    return np.full((count, 3), level, np.float32)


def over(rgb: np.ndarray, alpha: np.ndarray, background: np.ndarray | np.float32) -> np.ndarray:
    """Return premultiplied rgb composited over a background."""
    return rgb + (1 - alpha) * background


def target(colors: np.ndarray, background: np.ndarray | np.float32) -> np.ndarray:
    """Return straight rgba composited over a background."""
    return colors[:, :3] * colors[:, 3:] + (1 - colors[:, 3:]) * background


def unhidden(colors: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Return opaque targets [n, 4] for rays of a field with an opaque background, from photos' straight rgba [n, 4].

    Nothing is transparent there; alpha only masks distractors, such as a passer-by. Masked rays get the rendered color
    `found` [n, 3] as their target, which gives no gradient.
    """
    rgb = np.where(colors[:, 3:] > HIDDEN, colors[:, :3], found)
    return np.concatenate([rgb, np.ones_like(colors[:, 3:])], 1)


def shown_rays(
    origins: np.ndarray, directions: np.ndarray, colors: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the rays [n] that are not masked, made opaque; all of them if every one is masked."""
    shown = colors[:, 3] > HIDDEN
    shown = shown if shown.any() else np.ones_like(shown)
    return origins[shown], directions[shown], unhidden(colors[shown], np.zeros((int(shown.sum()), 3), np.float32))


class RayDataset:
    """8-bit photos and their cameras; rays are computed when drawn and never stored.

    photos: uint8 [h, w, 3 or 4] (straight alpha) per camera, of any sizes but with the same channels; or Pixels, whose
    bytes need not be in memory. Draws do not depend on where the bytes are.
    """

    def __init__(self, cameras: list[Camera], photos: list[np.ndarray] | Pixels) -> None:
        self.cameras = cameras
        self.widths = np.array([c.width for c in cameras], np.int64)
        self.sizes = np.array([c.width * c.height for c in cameras], np.int64)
        self._ends = np.cumsum(self.sizes)
        if not isinstance(photos, Pixels):
            for camera, image in zip(cameras, photos, strict=True):
                if image.shape[:2] != (camera.height, camera.width) or image.dtype != np.uint8:
                    raise InvalidValue(f"view {camera.name}: image {image.shape} does not fit its camera")
            photos = Pixels.of(photos)
        self.channels, self.bytes, self.read = photos.channels, photos.values, photos.read
        if self.bytes.dtype != np.uint8 or len(self.bytes) != self._ends[-1] * self.channels:
            raise InvalidValue(f"{len(self.bytes)} bytes do not hold {self._ends[-1]} pixels of {self.channels}")
        self.starts = (self._ends - self.sizes) * self.channels
        self.intrinsics = np.array([[c.fx, c.fy, c.cx, c.cy] for c in cameras], np.float32)
        self.poses = np.array([c.world_from_camera[:3] for c in cameras], np.float32)
        self.codes = codes_at(np.zeros(len(cameras)))  # [views, 256]: color of each byte value
        # Fully transparent pixels far from any object are uninformative, so they are drawn less often.
        self.lit = LitPixels(self.alphas()) if self.channels == 4 else None

    def alphas(self) -> Iterator[np.ndarray]:
        """Yield straight alpha [h, w] uint8 of each view in order; requires photos with four channels."""
        for camera, start, size in zip(self.cameras, self.starts, self.sizes):
            rgba = self.bytes[start : start + 4 * size].reshape(camera.height, camera.width, 4)
            yield rgba[..., 3].copy()
            self.read(math.ceil(4 * size / STRETCH))

    def __len__(self) -> int:
        return int(self._ends[-1])

    def expose(self, stops: np.ndarray) -> None:
        """Correct photos that are overexposed by stops [views] to a common exposure."""
        self.codes = codes_at(stops)

    def draw(
        self,
        count: int,
        generator: np.random.Generator,
        among: int | None = None,
        lit_share: float = 0.9,
        part: slice = slice(None),
        earlier: int = 0,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Draw `count` low-discrepancy rays (decision 0061) of the first `among` views, and compute those in `part`.

        earlier: number of rays already drawn with a generator in the same state; these continue that sequence.

        Returns:
            origins, directions [n, 3], colors [n, 4], views [n].
        """
        views, pixels = self.choose(count, generator, among, lit_share, part, earlier)
        return *self.at(views, pixels), views

    def choose(
        self,
        count: int,
        generator: np.random.Generator,
        among: int | None = None,
        lit_share: float = 0.9,
        part: slice = slice(None),
        earlier: int = 0,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return (views, row-major pixels) [n] of draw()'s rays; InvalidValue unless `among` is 1..number of views."""
        if among is not None and not 1 <= among <= len(self.cameras):
            raise InvalidValue(f"rays of the first {among} of {len(self.cameras)} views cannot be drawn")
        total = len(self) if among is None else int(self._ends[among - 1])
        # Draw all rays and cut to `part` last, so that every process consumes the same random stream.
        most = self.lit.below(total) if self.lit is not None and lit_share > 0 else 0
        if self.lit is None or most == 0:
            index = drawn_evenly(count, total, generator, earlier)
        else:
            near, earlier_near = int(count * lit_share), int(earlier * lit_share)
            index = self.lit[drawn_evenly(near, most, generator, earlier_near)]
            index = np.concatenate([index, drawn_evenly(count - near, total, generator, earlier - earlier_near)])
        index = index[part]
        views = np.searchsorted(self._ends, index, side="right")
        return views, index - (self._ends[views] - self.sizes[views])

    def of_views(
        self, first: int, count: int, generator: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return `count` uniformly random rays of the views from `first` on, and their colors; see at()."""
        views = generator.integers(first, len(self.cameras), count)
        return self.at(views, (generator.random(count) * self.sizes[views]).astype(np.int64))

    def at(self, views: np.ndarray, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return rays and colors of pixels [n]: (origins, directions [n, 3], colors [n, 4])."""
        n = len(views)
        origins, directions = np.empty((n, 3), np.float32), np.empty((n, 3), np.float32)
        colors = np.empty((n, 4), np.float32)
        photos = Photos(self.bytes, self.channels, self.starts, self.widths, self.intrinsics, self.poses, self.codes)
        gather(photos, views, pixels, origins, directions, colors)
        self.read(n)
        return origins, directions, colors
