"""Style, content and smoothness losses on features and images.

Losses return per-element values, which the caller weights and reduces. Features are [c, h, w] of one image; images are
[3, h, w], sRGB 0..1.
"""

import torch
import torch.nn.functional as F
from torch import Tensor

from stylerf.errors import InvalidValue
from stylerf.style.feature_matching import StyleRows, rows_of, unit_rows


def by_block(layers: tuple[str, ...], features: list[Tensor]) -> dict[str, Tensor]:
    """Concatenate features [1, c, h, w] of layers in one block along channels (ARF): {"conv3": [sum c, h, w], ...}."""
    blocks: dict[str, list[Tensor]] = {}
    for layer, feature in zip(layers, features, strict=True):
        blocks.setdefault(layer.split("_")[0], []).append(feature[0])
    return {block: parts[0] if len(parts) == 1 else torch.cat(parts) for block, parts in blocks.items()}


def position_weights(alpha: Tensor, features: Tensor, around: int = 0) -> Tensor:
    """Return the coverage of each feature position, [h', w'] in 0..1: alpha [h, w], area-averaged.

    around: radius of a maximum filter over positions, so that those next to the object count too.
    """
    covered = F.interpolate(alpha[None, None], size=features.shape[1:], mode="area")
    return F.max_pool2d(covered, 2 * around + 1, 1, around)[0, 0]


def nearest_neighbor_distance(
    features: Tensor,  # [c, h, w] of the render
    style: StyleRows,
    weights: Tensor | None = None,  # [h, w] >= 0; positions of weight 0 are neither matched nor differentiated
    memory_mb: float = 64.0,
    half: bool = False,
    matches: Tensor | None = None,  # indices from an earlier call, to skip the search
) -> tuple[Tensor, Tensor]:
    """Compute NNFM (ARF eq. 2): 1 - cos(F_i, S_j(i)) with j(i) the style row of largest cosine.

    The loss is distances.sum() / weights.sum(). There is no gradient through the matching or the style. All-zero
    features have distance 1 and gradient 0.

    Returns:
        Distances [p] in 0..2 of the positions of positive weight, times their weight, and their matches [p].
    """
    rows = rows_of(features)
    if weights is not None:
        flat = weights.flatten()
        inside = flat > 0
        rows, flat = rows[inside], flat[inside]
    if matches is None:
        matches = style.match(rows.detach(), memory_mb, half)
    distances = 1 - (unit_rows(rows) * style.rows[matches]).sum(dim=1)
    return (distances if weights is None else distances * flat), matches


def content_distance(features: Tensor, reference: Tensor) -> Tensor:
    """Return the squared difference of features [c, h, w] at each position, mean over channels, [h, w] (ARF)."""
    return (features - reference).square().mean(dim=0)


def gram_matrix(features: Tensor, weights: Tensor | None = None) -> Tensor:
    """Return F F^T / (c n), [c, c], of features [c, h, w]; n is h w, or the sum of `weights` [h, w]."""
    channels = features.shape[0]
    flat = features.flatten(1)
    if weights is None:
        return flat @ flat.T / (channels * flat.shape[1])
    total = weights.sum()
    # Reading the total on a GPU would wait for it; there the NaN that results is caught later.
    if not total.is_cuda and float(total) <= 0:
        raise InvalidValue("a Gram matrix needs a position of positive weight")
    return (flat * weights.flatten()) @ flat.T / (channels * total)


def gram_distance(features: Tensor, style_gram: Tensor, weights: Tensor | None = None) -> Tensor:
    """Return the squared differences of Gram matrices, [c, c] (Gatys et al.; LAENeRF uses their mean)."""
    return (gram_matrix(features, weights) - style_gram).square()


def squared_variation(image: Tensor) -> tuple[Tensor, Tensor]:
    """Return squared differences of horizontal [c, h, w-1] and vertical [c, h-1, w] neighbors."""
    return (image[:, :, 1:] - image[:, :, :-1]).square(), (image[:, 1:] - image[:, :-1]).square()


def image_variation(image: Tensor) -> Tensor:
    """Return ARF's total variation, a scalar: (mean dx^2 + mean dy^2) / 2 of an image [3, h, w]."""
    horizontal, vertical = squared_variation(image)
    return (horizontal.mean() + vertical.mean()) / 2


def diagonal_variation(image: Tensor) -> Tensor:
    """Return DeSRF's variation (eq. 6) at each pixel, [h, w]: ||grad_u x + grad_v x|| over color, forward differences.

    As printed, the differences are added before the norm, so a ramp along the rising diagonal is free. The gradient at
    a flat pixel is 0.
    """
    right = F.pad(image[:, :, 1:] - image[:, :, :-1], (0, 1))
    down = F.pad(image[:, 1:] - image[:, :-1], (0, 0, 0, 1))
    return torch.linalg.vector_norm(right + down, dim=0)
