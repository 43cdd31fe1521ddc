"""Losses on the edges of a stylized view: missing edges of the photo, and grain beyond the style image's."""

from math import ceil, sqrt

import torch
import torch.nn.functional as F
from torch import Tensor

from stylerf.srgb import LUMA

EDGE_CELL = 4  # pixels; finer edges would mostly be grain
EDGE_CONTRAST = 0.5  # fraction of an edge's contrast that is enough (decision 0068)
EDGE_AREA = 5  # cells per side in which contrast is compared
PAINTED = 0.25  # weight of a missing edge where strokes have at least the photo's contrast (decision 0069)
GRAIN_CELL = 2  # pixels
RANKS = 33  # quantiles of gradients, evenly spaced up to HIGHEST
HIGHEST = 0.98
PLAIN = 0.02  # of luma; style images with weaker gradients have no edges to compare with
SAMPLES = 16384  # cells of an image that quantiles are taken of


def luma_gradient(picture: Tensor, cell: int = EDGE_CELL) -> Tensor:
    """Return the luma gradient (right, down) between cells of an image [3, h, w], [2, h // cell, w // cell]."""
    weights = picture.new_tensor(LUMA)[:, None, None]
    luma = F.avg_pool2d((weights * picture).sum(0)[None], cell)[0]
    return torch.stack([F.pad(luma[:, 1:] - luma[:, :-1], (0, 1)), F.pad(luma[1:] - luma[:-1], (0, 0, 0, 1))])


def missing_edges(picture: Tensor, wanted: Tensor, alpha: Tensor | None = None) -> Tensor:
    """Return how much of the photo's edges is missing: the mean of w max(0, |p| / 2 - <r, p / |p|>), weighted by alpha.

    r is the luma gradient of an image [3, h, w], p that of its photo; w is blank_weights(). Plain parts of a style
    image may not cover details such as petals, letters or faces; strokes may replace them for the most part.

    Args:
        wanted: p, [2, h', w'].
        alpha: [h, w], or None for 1 everywhere.
    """
    found, length = luma_gradient(picture), torch.linalg.vector_norm(wanted, dim=0)
    along = (found * wanted).sum(0) / length.clamp_min(1e-6)
    missing = F.relu(EDGE_CONTRAST * length - along) * blank_weights(found, length)
    if alpha is None:
        return missing.mean()
    weights = F.avg_pool2d(alpha[None], EDGE_CELL)[0]
    return (missing * weights).sum() / weights.sum().clamp_min(1e-6)


@torch.no_grad()
def blank_weights(found: Tensor, length: Tensor) -> Tensor:
    """Return the weight of a missing edge at each cell, [h', w']: 1 in blank areas, PAINTED at strokes; no gradient.

    With R and P the means of |r| and |p| over EDGE_AREA x EDGE_AREA cells: 1 for R up to EDGE_CONTRAST P, then falling
    linearly to PAINTED at R = P.

    Args:
        found: Luma gradient r of the image, [2, h', w'].
        length: |p| of the photo, [h', w'].
    """
    gradients = torch.stack([torch.linalg.vector_norm(found, dim=0), length])
    present, wanted = F.avg_pool2d(gradients, EDGE_AREA, 1, EDGE_AREA // 2, count_include_pad=False)
    blank = ((1 - present / wanted.clamp_min(1e-4)) / (1 - EDGE_CONTRAST)).clamp(0, 1)
    return PAINTED + (1 - PAINTED) * blank


def gradient_lengths(picture: Tensor, alpha: Tensor | None = None, cell: int = GRAIN_CELL) -> Tensor:
    """Return the lengths of the luma gradient, [h // cell, w // cell], of an image [3, h, w].

    alpha: [h, w]; lengths are nan where a cell is mostly transparent.
    """
    lengths = torch.linalg.vector_norm(luma_gradient(picture, cell), dim=0)
    return lengths if alpha is None else lengths.where(F.avg_pool2d(alpha[None], cell)[0] > 0.5, torch.nan)


def quantiles(lengths: Tensor) -> Tensor:
    """Return quantiles 0 to HIGHEST of lengths [h, w], [RANKS], without nan; nan if there is nothing else."""
    if not lengths.numel():
        return lengths.new_full((RANKS,), torch.nan)
    step = ceil(sqrt(max(1.0, lengths.numel() / SAMPLES)))
    return torch.nanquantile(lengths[::step, ::step], torch.linspace(0, HIGHEST, RANKS).to(lengths))


@torch.no_grad()
def style_gradients(style_image: Tensor, cell: int) -> Tensor:
    """Return quantiles of a style image's gradients, [RANKS]; inf for an image without edges, to limit nothing.

    Args:
        style_image: [3 or 4, h, w], scaled; a fourth channel is alpha.
        cell: Side of the cells, pixels.
    """
    found = quantiles(gradient_lengths(style_image[:3], style_image[3] if len(style_image) == 4 else None, cell))
    return found if float(found[-1]) > PLAIN else torch.full_like(found, torch.inf)


@torch.no_grad()
def limited_lengths(lengths: Tensor, style: Tensor) -> Tensor:
    """Return gradient lengths [h, w], shortened to a style image's of the same rank; style: see style_gradients().

    If the strongest are stronger than the style image's, the latter are scaled until HIGHEST agrees: flat planes
    between hard edges have few gradients of middling length at any contrast. Those beyond HIGHEST, and nan, stay.
    """
    own = quantiles(lengths)
    wanted = torch.minimum(own, style * (own[-1] / style[-1]).clamp_min(1))
    above = torch.searchsorted(own, lengths).clamp(1, RANKS - 1)
    low, high = own[above - 1], own[above]
    part = ((lengths - low) / (high - low).clamp_min(1e-6)).clamp(0, 1)
    return torch.where(lengths < own[-1], torch.lerp(wanted[above - 1], wanted[above], part), lengths)


def possible_edges(edges: Tensor, style: Tensor) -> Tensor:
    """Shorten a photo's edges, [2, h, w], so that missing_edges() asks for none that the style image does not have.

    style: See style_gradients(), with EDGE_CELL.
    """
    enough = EDGE_CONTRAST * torch.linalg.vector_norm(edges, dim=0)
    return edges * (limited_lengths(enough, style) / enough.clamp_min(1e-6)).clamp_max(1)


def grain(picture: Tensor, style: Tensor, alpha: Tensor | None = None) -> Tensor:
    """Return by how much an image's gradients exceed the style image's of the same rank, the mean over cells.

    Weaker gradients are free: this is one side of the Wasserstein distance between the distributions of lengths, which
    limited_lengths() scales.

    Args:
        picture: [3, h, w].
        style: See style_gradients(), with GRAIN_CELL.
        alpha: [h, w], coverage by the object; other cells do not count. None for 1 everywhere.
    """
    lengths = gradient_lengths(picture, alpha)
    excess = F.relu(lengths - limited_lengths(lengths.detach(), style))
    return excess.nansum() / lengths.isfinite().sum().clamp_min(1)
