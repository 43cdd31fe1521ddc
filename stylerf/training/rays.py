"""The training set as the loop sees it: random rays with their target colours."""

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.geometry.cameras import Camera
from stylerf.kernels.cpu.pixels import gather


class RayBank:
    """8-bit images in memory and their cameras; rays are made when asked for.

    images: list of uint8 [h, w, 3 or 4] (straight alpha), of any sizes, all with as many channels.
    """

    def __init__(self, cameras: list[Camera], images: list[np.ndarray]) -> None:
        for camera, image in zip(cameras, images, strict=True):
            if image.shape[:2] != (camera.height, camera.width) or image.dtype != np.uint8:
                raise InvalidValue(f"view {camera.name}: image {image.shape} does not fit its camera")
        self.channels = images[0].shape[2]
        self.cameras = cameras
        self.widths = np.array([c.width for c in cameras], np.int64)
        self.sizes = np.array([c.width * c.height for c in cameras], np.int64)
        self.starts = np.concatenate([[0], np.cumsum(self.sizes * self.channels)[:-1]]).astype(np.int64)
        self.bytes = np.concatenate([i.reshape(-1) for i in images])
        self.intrinsics = np.array([[c.fx, c.fy, c.cx, c.cy] for c in cameras], np.float32)
        self.poses = np.array([c.world_from_camera[:3] for c in cameras], np.float32)
        self._ends = np.cumsum(self.sizes)
        # Fully transparent pixels away from any object teach little: they are drawn less often.
        self.lit = None
        if self.channels == 4:
            self.lit = self._near_opaque(images)

    def _near_opaque(self, images: list[np.ndarray]) -> np.ndarray:
        from scipy.ndimage import binary_dilation

        lit = [binary_dilation(i[..., 3] > 0, iterations=max(2, i.shape[0] // 50)).ravel() for i in images]
        return np.flatnonzero(np.concatenate(lit))

    def __len__(self) -> int:
        return int(self._ends[-1])

    def draw(self, count: int, generator: np.random.Generator, among: int | None = None, lit_share: float = 0.9):
        """`count` random rays of the first `among` views: (origins, directions [n, 3], colours [n, 4], views [n])."""
        total = len(self) if among is None else int(self._ends[among - 1])
        index = generator.integers(0, total, count)
        if self.lit is not None and lit_share > 0:
            most = np.searchsorted(self.lit, total)
            if most:
                chosen = int(count * lit_share)
                index[:chosen] = self.lit[generator.integers(0, most, chosen)]
        views = np.searchsorted(self._ends, index, side="right")
        pixels = index - (self._ends[views] - self.sizes[views])
        return *self.at(views, pixels), views

    def at(self, views: np.ndarray, pixels: np.ndarray):
        """Rays and colours of given pixels: (origins, directions [n, 3], colours [n, 4])."""
        n = len(views)
        origins, directions = np.empty((n, 3), np.float32), np.empty((n, 3), np.float32)
        colours = np.empty((n, 4), np.float32)
        gather(
            views,
            pixels,
            self.widths,
            self.intrinsics,
            self.poses,
            self.starts,
            self.bytes,
            self.channels,
            origins,
            directions,
            colours,
        )
        return origins, directions, colours
