"""What the launches take in place of long argument lists; as kernels/cpu/ray_samples.py, in tensors."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor


@dataclass
class GpuRays:
    """origins, directions (unit) [n, 3]; jitter [n] in 0..1 of a step: float32 on the device."""

    origins: Tensor
    directions: Tensor
    jitter: Tensor

    @staticmethod
    def of(origins: np.ndarray, directions: np.ndarray, device: torch.device) -> "GpuRays":
        """Copy rays to a device, to be marched from the middle of their first step."""
        here, ways = (torch.from_numpy(np.ascontiguousarray(a, np.float32)).to(device) for a in (origins, directions))
        return GpuRays(here, ways, torch.full((len(origins),), 0.5, device=device))


@dataclass
class GpuSamples:
    """Samples along rays, packed without padding; as Samples in kernels/cpu/ray_samples.py, and beyond that:

    Attributes:
        counts: [rays], samples that each ray wanted; its starts:ends is empty if they do not fit.
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
        """Number of samples that fit."""
        return len(self.t)


@dataclass
class GpuAdamState:
    """A table and what its optimizer keeps: values, gradients and both moments [n] float32."""

    values: Tensor
    gradients: Tensor
    first: Tensor
    second: Tensor


@dataclass
class GpuPhotos:
    """8-bit photos and their cameras on the device, all views laid end to end.

    Attributes:
        bytes: [sum of h w channels] uint8.
        lit: [m] int32, pixels near something opaque, numbered across all views.
        view_ends, view_sizes: [views] int64, the number after a view's last pixel, and how many it has.
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
    """Which rays of a random batch are drawn: from `first` on.

    Pixels continue `sequence` after `earlier` draws, of lit ones lit_earlier; jitter and background are of `seed`.
    The batch's first lit_rays take one of the first lit_total lit pixels, the others one of the first `total` pixels.
    level: gray of the background; None: random colors.
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
    """What a march reads beside rays and density; space: numbers [7] on the device; step: cube units."""

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
