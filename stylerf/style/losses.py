"""Style, content and smoothness losses on features and images.

Every loss returns its per-element values; the caller weighs and reduces them. Features are [c, h, w] of one image,
images [3, h, w] sRGB in [0, 1].
"""

import torch
import torch.nn.functional as F
from torch import Tensor

from stylerf.errors import InvalidValue
from stylerf.style.feature_matching import StyleRows, rows_of, unit_rows


def by_block(taps: tuple[str, ...], features: list[Tensor]) -> dict[str, Tensor]:
    """Taps of one block joined along channels (ARF): {"conv3": [sum c, h, w], ...} from [1, c, h, w] features."""
    blocks: dict[str, list[Tensor]] = {}
    for tap, feature in zip(taps, features, strict=True):
        blocks.setdefault(tap.split("_")[0], []).append(feature[0])
    return {block: parts[0] if len(parts) == 1 else torch.cat(parts) for block, parts in blocks.items()}


def position_weights(alpha: Tensor, features: Tensor, around: int = 0) -> Tensor:
    """Share of each feature position that the object covers, [h', w'] in [0, 1]: alpha [h, w] averaged there.

    around: positions beside the object that count as much as the fullest within this reach of them.
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
    """NNFM (ARF eq. 2): 1 - cos(F_i, S_j(i)) with j(i) the style row of greatest cosine.

    Returns the distances of the positions taking part, [p] in [0, 2], each times its weight (all ones without
    `weights`), and their matches [p]. The loss is distances.sum() / weights.sum(). No gradient through the choice or
    the style; a position whose features are all zero has distance 1 and gradient 0.
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
    """Squared difference of each position averaged over channels, [h, w], from two [c, h, w]; its mean is ARF's."""
    return (features - reference).square().mean(dim=0)


def gram_matrix(features: Tensor, weights: Tensor | None = None) -> Tensor:
    """F F^T / (c n) [c, c] of features [c, h, w] with n = h w positions, or n = sum of `weights` [h, w]."""
    channels = features.shape[0]
    flat = features.flatten(1)
    if weights is None:
        return flat @ flat.T / (channels * flat.shape[1])
    total = weights.sum()
    # To ask a device is to wait for it; there the NaN that follows tells.
    if not total.is_cuda and float(total) <= 0:
        raise InvalidValue("a Gram matrix over no position: every weight is 0")
    return (flat * weights.flatten()) @ flat.T / (channels * total)


def gram_distance(features: Tensor, style_gram: Tensor, weights: Tensor | None = None) -> Tensor:
    """Squared difference of each entry of the Gram matrices, [c, c] (Gatys et al.; LAENeRF takes its mean)."""
    return (gram_matrix(features, weights) - style_gram).square()


def squared_variation(image: Tensor) -> tuple[Tensor, Tensor]:
    """Squared differences of horizontal [c, h, w-1] and vertical [c, h-1, w] neighbors; see `image_variation`."""
    return (image[:, :, 1:] - image[:, :, :-1]).square(), (image[:, 1:] - image[:, :-1]).square()


def image_variation(image: Tensor) -> Tensor:
    """ARF's total variation, scalar: (mean dx^2 + mean dy^2) / 2 of an image [3, h, w]."""
    horizontal, vertical = squared_variation(image)
    return (horizontal.mean() + vertical.mean()) / 2


def diagonal_variation(image: Tensor) -> Tensor:
    """DeSRF eq. 6 per pixel, [h, w]: ||grad_u x + grad_v x|| over color, forward differences, 0 past the last pixel.

    As printed, the two differences are added before the norm, so a ramp along the rising diagonal is free. Its
    gradient at a flat pixel is 0.
    """
    right = F.pad(image[:, :, 1:] - image[:, :, :-1], (0, 1))
    down = F.pad(image[:, 1:] - image[:, :-1], (0, 0, 0, 1))
    return torch.linalg.vector_norm(right + down, dim=0)
