"""Dataclasses of tensors, which launches take instead of long argument lists; see kernels/cpu/ray_samples.py."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor


@dataclass
class GpuRays:
    """origins, directions (unit) [n, 3]; jitter [n] in 0..1 of a step. All float32 on the device."""

    origins: Tensor
    directions: Tensor
    jitter: Tensor

    @staticmethod
    def of(origins: np.ndarray, directions: np.ndarray, device: torch.device) -> "GpuRays":
        """Copy rays to a device; marching starts in the middle of their first step."""
        here, ways = (torch.from_numpy(np.ascontiguousarray(a, np.float32)).to(device) for a in (origins, directions))
        return GpuRays(here, ways, torch.full((len(origins),), 0.5, device=device))


@dataclass
class GpuSamples:
    """Samples along rays, packed without padding; like Samples in kernels/cpu/ray_samples.py, plus:

    Attributes:
        counts: [rays], samples that each ray needed; its starts:ends is empty if they do not fit.
        largest: [rays], each ray's largest weight.
        total: [1] int64, number of samples.
        ray_of: [capacity], each sample's ray.
    """

    starts: Tensor
    ends: Tensor
    counts: Tensor
    largest: Tensor
    total: Tensor
    t: Tensor
    deltas: Tensor
    x: Tensor
    sigma: Tensor
    weights: Tensor
    ray_of: Tensor

    @property
    def capacity(self) -> int:
        """Maximum number of samples."""
        return len(self.t)


@dataclass
class GpuAdamState:
    """A table and its optimizer state: values, gradients and both moments [n] float32."""

    values: Tensor
    gradients: Tensor
    first: Tensor
    second: Tensor


@dataclass
class GpuPhotos:
    """8-bit photos and their cameras on the device, with all views concatenated.

    Attributes:
        bytes: [sum of h w channels] uint8.
        lit: [m] int32, pixels near objects, counted across all views.
        view_ends, view_sizes: [views] int64, the index after a view's last pixel, and its number of pixels.
        widths: [views] int64.
        intrinsics: [views, 4]; poses: [views, 3, 4]; codes: [views, 256]: as in kernels/cpu/photos.py.
    """

    bytes: Tensor
    channels: int
    lit: Tensor
    view_ends: Tensor
    view_sizes: Tensor
    widths: Tensor
    intrinsics: Tensor
    poses: Tensor
    codes: Tensor


@dataclass(frozen=True)
class RayDraw:
    """Which rays of a random batch to draw: from `first` on.

    Pixels continue `sequence` after `earlier` draws, lit ones after lit_earlier; `seed` is for jitter and background.
    The batch's first lit_rays draw from the first lit_total lit pixels, the others from the first `total` pixels.
    level: gray level of the background; None: random colors.
    """

    seed: int
    sequence: int
    earlier: int
    lit_earlier: int
    first: int
    total: int
    lit_total: int
    lit_rays: int
    level: float | None


@dataclass(frozen=True)
class GpuMarchInputs:
    """Inputs of ray marching other than rays and density; space: parameters [7] on the device; step: cube units."""

    code: int
    space: Tensor
    near: float
    far: float
    step: float
    distances: Tensor  # [cells^3] uint8
    cells: int
    opaque_background: bool
    displacement: Tensor | None  # flat [m^3 * 3]
    vertices: int
    samples_per_ray: int
    min_transmittance: float
