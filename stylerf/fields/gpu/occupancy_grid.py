"""The occupancy grid (fields/occupancy_grid.py) on a GPU, updated without waiting for the device."""

import math

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from stylerf.fields.occupancy_grid import DENSEST, MARK, OPAQUE_STEP, UNSEEN
from stylerf.kernels.cpu.march import OPTICAL_SCALE

FARTHEST = 32  # cells; larger distances are clamped to this: rays skip less, but never too far


def refresh(field, seed: int, stride: int, decay: float) -> None:
    """Evaluate the density of a GpuField in every stride-th cell, then decide what is occupied."""
    device, cells = field.device, field.cells
    generator = torch.Generator(device).manual_seed(seed)
    start = int(np.random.default_rng(seed).integers(stride))  # a seed modulo the stride may never vary
    index = torch.arange(start, cells**3, stride, device=device)
    corner = torch.stack([index // cells**2, index // cells % cells, index % cells], 1)
    points = (corner + torch.rand(corner.shape, generator=generator, device=device)) / cells
    seen = field.density.sigma(points.contiguous()).clamp(max=DENSEST)
    old = field.highest[index]
    field.highest[index] = torch.maximum(torch.where(old == UNSEEN, 0.0, old * decay), seen)
    if field.clear is not None:
        field.highest.masked_fill_(field.clear, 0.0)
    decide(field)


def decide(field) -> None:
    """Recompute the distances of a GpuField from the densities seen in its cells."""
    cells = field.cells
    threshold = -math.log1p(-OPAQUE_STEP) / (float(OPTICAL_SCALE) * field.step)
    occupied = field.highest > field.highest.clamp(max=MARK).mean().clamp(max=threshold)
    if field.clear is not None:
        occupied &= ~field.clear
    field.distances = distances_to(occupied.view(cells, cells, cells)).flatten()


def distances_to(occupied: Tensor, farthest: int = FARTHEST) -> Tensor:
    """Return the Chebyshev distance of each cell of [m, m, m] bool to the nearest True, at most `farthest`; uint8.

    Axis by axis, a dozen launches in all: a cell's distance is the minimum, over the cells of its line, of the maximum
    of the way to that cell and that cell's own distance so far.
    """
    farthest = min(farthest, len(occupied))
    distance = torch.full_like(occupied, farthest, dtype=torch.uint8).masked_fill_(occupied, 0)
    ways = torch.arange(1 - farthest, farthest, device=occupied.device).abs().to(torch.uint8)
    for axis in range(3):
        margins = [farthest - 1 if a == axis else 0 for a in (2, 1, 0) for _ in range(2)]
        lines = F.pad(distance, margins, value=farthest).unfold(axis, len(ways), 1)
        distance = torch.maximum(lines, ways).amin(-1)
    return distance
