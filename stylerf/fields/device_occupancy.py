"""fields/occupancy.py's grid kept up to date on a device, without waiting for it."""

import math

import torch
import torch.nn.functional as F
from torch import Tensor

from stylerf.fields.occupancy import OPAQUE_STEP
from stylerf.kernels.oracle import OPTICAL_SCALE

FARTHEST = 32  # cells; distances beyond are told as this one: leaps come out shorter, never wrong


def refresh(field, seed: int, share: int, decay: float) -> None:
    """Look at one cell in `share` of a DeviceField at a random point, then decide anew what is occupied."""
    device, cells = field.device, field.cells
    generator = torch.Generator(device).manual_seed(seed)
    index = torch.arange(seed % share, cells**3, share, device=device)
    corner = torch.stack([index // cells**2, index // cells % cells, index % cells], 1)
    points = (corner + torch.rand(corner.shape, generator=generator, device=device)) / cells
    seen = field.density.sigma(points.contiguous())
    field.highest.clamp_(max=1e4)  # infinite where nobody has looked yet
    old = field.highest[index]
    field.highest[index] = torch.maximum(torch.where(old >= 1e4, 0.0, old * decay), seen)
    least = -math.log1p(-OPAQUE_STEP) / (OPTICAL_SCALE * field.step)
    occupied = field.highest > field.highest.clamp(max=1e4).mean().clamp(max=least)
    if field.clear is not None:
        occupied &= ~field.clear
    field.distances = distances_to(occupied.view(cells, cells, cells)).flatten()


def distances_to(occupied: Tensor, farthest: int = FARTHEST) -> Tensor:
    """Chebyshev distance, in cells, of each cell of [m, m, m] bool to the nearest True, at most `farthest`; uint8.

    A cell at distance d is missed by the first d of the growths by one cell, counted from the grid itself.
    """
    reached = occupied[None, None].to(torch.float32)
    distance = torch.zeros_like(occupied, dtype=torch.uint8)
    for _ in range(min(farthest, len(occupied))):
        distance += (reached[0, 0] == 0).to(torch.uint8)
        for axis in range(3):
            window = [3 if a == axis else 1 for a in range(3)]
            reached = F.max_pool3d(reached, window, stride=1, padding=[w // 2 for w in window])
    return distance
