"""Training photos on a device, with random rays and their colors drawn there."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from stylerf.errors import InvalidValue
from stylerf.kernels.gpu import launch
from stylerf.kernels.gpu.ray_samples import GpuPhotos, GpuRays, RayDraw
from stylerf.training.common.ray_dataset import HIDDEN, STRETCH, RayDataset

AT_ONCE = 1 << 22  # bytes of photos, or indices of pixels, per copy to the device


def unhidden(wanted: Tensor, out: Tensor, background: Tensor | float) -> Tensor:
    """Return targets as ray_dataset.unhidden() does, from rendered rays `out` [n, 5] over a background."""
    found = out[:, :3] + (1 - out[:, 3:4]) * background
    rgb = torch.where(wanted[:, 3:] > HIDDEN, wanted[:, :3], found)
    return torch.cat([rgb, torch.ones_like(wanted[:, 3:])], 1)


@dataclass
class RayBatch:
    """Rays, their target straight rgba `wanted` [n, 4] in 0..1, and background [n, 3]."""

    rays: GpuRays
    wanted: Tensor
    background: Tensor


class GpuRayDataset:
    """dataset: photos and cameras, copied to the device once, one byte per channel."""

    def __init__(self, dataset: RayDataset, device: torch.device) -> None:
        # Lit pixels are listed as int32, to halve the memory.
        if len(dataset) >= 2**31:
            raise InvalidValue(f"{len(dataset)} pixels of photos; at most {2**31 - 1} can be drawn from on a GPU")
        self.device, self.channels, self.views = device, dataset.channels, len(dataset.cameras)
        self.ends = np.cumsum(dataset.sizes)
        self.photos = GpuPhotos(
            self._bytes(dataset), dataset.channels, self._near_objects(dataset), self._copy(self.ends),
            self._copy(dataset.sizes), self._copy(dataset.widths), self._copy(dataset.intrinsics),
            self._copy(dataset.poses), self._copy(dataset.codes),
        )  # fmt: skip
        self._host = dataset

    def _copy(self, array: np.ndarray) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(array)).to(self.device)

    def _bytes(self, dataset: RayDataset) -> Tensor:
        """Copy the bytes in parts, so that a mapped file is never in memory as a whole."""
        there = torch.empty(len(dataset.bytes), dtype=torch.uint8, device=self.device)
        for at in range(0, len(there), AT_ONCE):
            # A copy, because read() may release the mapped pages before they reach the device.
            part = dataset.bytes[at : at + AT_ONCE].copy()
            dataset.read(math.ceil(len(part) / STRETCH))
            there[at : at + len(part)] = torch.from_numpy(part)
        return there

    def _near_objects(self, dataset: RayDataset) -> Tensor:
        """Return the pixels near objects as an int32 list for the device to draw from; the dataset stores runs."""
        if dataset.lit is None:
            return torch.zeros(1, dtype=torch.int32, device=self.device)
        count = dataset.lit.below(len(dataset))
        there = torch.zeros(max(1, count), dtype=torch.int32, device=self.device)
        for at in range(0, count, AT_ONCE):
            part = dataset.lit[np.arange(at, min(at + AT_ONCE, count))].astype(np.int32)
            there[at : at + len(part)] = torch.from_numpy(part)
        return there

    def follow_exposure(self) -> None:
        """Copy the host dataset's current exposure correction."""
        self.photos.codes = self._copy(self._host.codes)

    def draw(
        self,
        seed: int,
        first: int,
        count: int,
        batch: int,
        among: int,
        lit_share: float,
        level: float | None,
        sequence: int = 0,
        earlier: int = 0,
    ) -> RayBatch:
        """Draw rays `first` to `first + count` of a batch of `batch` random rays, from the first `among` views.

        sequence, earlier: Pixels continue the sequence with this seed after `earlier` rays, as in RayDataset.draw().
        seed: For jitter and background.
        lit_share: Fraction of the batch through pixels near objects. level: Gray level of the background; None: random
        colors.
        """
        total = int(self.ends[among - 1])
        most_lit = 0 if self._host.lit is None else self._host.lit.below(total)
        lit_rays, lit_earlier = (int(rays * lit_share) if most_lit else 0 for rays in (batch, earlier))
        drawn = RayDraw(seed, sequence, earlier - lit_earlier, lit_earlier, first, total, most_lit, lit_rays, level)
        return RayBatch(*launch.draw_rays(self.photos, drawn, count))

    def at(self, chosen: Tensor, jitter: Tensor) -> tuple[GpuRays, Tensor]:
        """Return (rays, straight rgba [n, 4]) of pixels `chosen` [n] int64, indexed as by number_of(); jitter [n]."""
        origins, directions, wanted = launch.rays_of_pixels(self.photos, chosen)
        return GpuRays(origins, directions, jitter), wanted

    def number_of(self, views: np.ndarray, pixels: np.ndarray) -> np.ndarray:
        """Return indices [n] int64 of row-major pixels of views, into the concatenation of all views."""
        begins = np.concatenate([[0], self.ends[:-1]])
        return begins[views] + pixels
