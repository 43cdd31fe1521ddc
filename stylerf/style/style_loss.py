"""The loss of a stylized view: style features, content, total variation (ARF eq. 4), and local mean colors.

The color term preserves local mean colors of the photo, which has been matched to the style image's colors.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from stylerf.errors import InvalidValue
from stylerf.style.edge_loss import (
    EDGE_CELL,
    GRAIN_CELL,
    grain,
    luma_gradient,
    missing_edges,
    possible_edges,
    style_gradients,
)
from stylerf.style.feature_extractor import FeatureExtractor, by_block, feature_size, features, resized
from stylerf.style.feature_matching import StyleRows, rows_of, style_rows, unit_rows
from stylerf.style.style_features import stroke_picture, style_features
from stylerf.style.transport import transport_targets


def position_weights(alpha: Tensor, features: Tensor, around: int = 0) -> Tensor:
    """Return the coverage of each feature position, [h', w'] in 0..1: alpha [h, w], area-averaged.

    around: radius of a maximum filter over positions, so that those next to the object also count.
    """
    covered = F.interpolate(alpha[None, None], size=features.shape[1:], mode="area")
    return F.max_pool2d(covered, 2 * around + 1, 1, around)[0, 0]


def nearest_positions(sizes: Tensor, features: Tensor) -> Tensor:
    """Return the value of integers [h, w] at each feature position, [h', w']: that of the nearest pixel."""
    return F.interpolate(sizes[None, None].float(), size=features.shape[1:], mode="nearest")[0, 0].long()


def nearest_neighbor_distance(
    features: Tensor,  # [c, h, w] of the render
    style: StyleRows,
    weights: Tensor | None = None,  # [h, w] >= 0; positions with weight 0 are neither matched nor differentiated
    memory_mb: float = 64.0,
    half: bool = False,
    matches: Tensor | None = None,  # indices from an earlier call, to skip the search
) -> tuple[Tensor, Tensor]:
    """Compute NNFM (ARF eq. 2): 1 - cos(F_i, S_j(i)) with j(i) the style row with the largest cosine.

    The loss is distances.sum() / weights.sum(). There is no gradient through the matching or the style. All-zero
    features have distance 1 and gradient 0.

    Returns:
        Distances [p] in 0..2 at positions with positive weight, times their weight, and their matches [p].
    """
    rows = rows_of(features)
    if weights is not None:
        flat = weights.flatten()
        inside = flat > 0
        rows, flat = rows[inside], flat[inside]  # [positions, c] -> [p, c]
    if matches is None:
        matches = style.match(rows.detach(), memory_mb, half)
    distances = 1 - (unit_rows(rows) * style.rows[matches]).sum(dim=1)
    return (distances if weights is None else distances * flat), matches


def content_distance(features: Tensor, reference: Tensor) -> Tensor:
    """Return the squared difference of features [c, h, w] at each position, averaged over channels, [h, w] (ARF)."""
    return (features - reference).square().mean(dim=0)


def gram_matrix(features: Tensor, weights: Tensor | None = None) -> Tensor:
    """Return F F^T / (c n), [c, c], of features [c, h, w]; n is h w, or the sum of `weights` [h, w]."""
    if weights is None:
        return _gram(features, None, features[0].numel())
    total = weights.sum()
    # Reading the total on a GPU would synchronize; there, the resulting NaN is caught later.
    if not total.is_cuda and float(total) <= 0:
        raise InvalidValue("a Gram matrix needs a position of positive weight")
    return _gram(features, weights, total)


def _gram(features: Tensor, weights: Tensor | None, total: Tensor | int) -> Tensor:
    flat = features.flatten(1)
    return (flat if weights is None else flat * weights.flatten()) @ flat.T / (len(flat) * total)


def gram_difference(features: Tensor, style_gram: Tensor, weights: Tensor | None = None) -> Tensor:
    """Return |G - S|^2 / (|G|^2 + |S|^2) of Gram matrices, a scalar: 0 if equal, 1 if they have no features in common.

    Normalized by both, so that it cannot dominate other terms for any photo and style image. 1, without a gradient, if
    all weights [h, w] are 0.
    """
    total = features[0].numel() if weights is None else weights.sum().clamp_min(1e-6)
    gram = _gram(features, weights, total)
    scale = gram.square().sum() + style_gram.square().sum()
    return (gram - style_gram).square().sum() / scale.clamp_min(1e-12)


def gram_distance(features: Tensor, style_gram: Tensor, weights: Tensor | None = None) -> Tensor:
    """Return the squared differences of Gram matrices, [c, c] (Gatys et al.; LAENeRF uses their mean)."""
    return (gram_matrix(features, weights) - style_gram).square()


def image_variation(image: Tensor) -> Tensor:
    """Return ARF's total variation, a scalar: (mean dx^2 + mean dy^2) / 2 of an image [3, h, w]."""
    horizontal, vertical = image[:, :, 1:] - image[:, :, :-1], image[:, 1:] - image[:, :-1]
    return (horizontal.square().mean() + vertical.square().mean()) / 2


def diagonal_variation(image: Tensor) -> Tensor:
    """Return DeSRF's variation (eq. 6) per pixel, [h, w]: ||grad_u x + grad_v x|| over color, forward differences.

    As printed in the paper, the differences are added before the norm, so a ramp along the rising diagonal costs
    nothing. The gradient at a flat pixel is 0.
    """
    right = F.pad(image[:, :, 1:] - image[:, :, :-1], (0, 1))
    down = F.pad(image[:, 1:] - image[:, :-1], (0, 0, 0, 1))
    return torch.linalg.vector_norm(right + down, dim=0)


POSITIONS = 2048  # features per block that transport matches in a step
GRADIENT_SIDE = 2048  # pixels at most of the style image whose gradients count
CELLS = 32  # along the longer side: the resolution of the color term
Window = tuple[slice, slice]  # rows and columns of an image
EVERYTHING: Window = (slice(None), slice(None))
VARIATIONS: dict[str, Callable[[Tensor], Tensor]] = {
    "squared": image_variation,
    "diagonal": lambda picture: diagonal_variation(picture).mean(),
}


@dataclass(frozen=True)
class StyleWeights:
    """Weights of the loss terms.

    Attributes:
        style: Of the style distance.
        content: Of the content distance, relative to the style image's mean squared feature: squared features of
            different extractors differ by a factor of up to 10,000, so absolute weights (ARF: 1e-3) do not transfer.
        variation: Of the total variation.
        color: Of the mean squared difference of mean colors in CELLS cells: features hardly depend on color, which
            would otherwise drift (decision 0012).
        structure: Of the photo's missing edges (see missing_edges(), possible_edges()).
        grain: Of gradients beyond the style image's (see grain()).
        gram: Of gram_difference() within the style distance, in addition to the distance of single features.
    """

    style: float = 1.0
    content: float = 1e-2
    variation: float = 1.0
    color: float = 10.0
    structure: float = 0.0
    gram: float = 0.0
    grain: float = 0.0

    @property
    def need_photo(self) -> bool:
        """Whether any term depends on the photo."""
        return self.content > 0 or self.color > 0 or self.structure > 0


@dataclass(frozen=True)
class Content:
    """Targets from a view's photo: features by block, mean colors of cells [3, rows, columns], edges."""

    features: dict[str, Tensor]
    colors: Tensor
    edges: Tensor

    @property
    def bytes(self) -> int:
        """Memory used, bytes."""
        return sum(t.numel() * t.element_size() for t in (*self.features.values(), self.colors, self.edges))


class FeatureLoss:
    """Base of losses on features. All tensors are on the feature extractor's device.

    On a GPU, the extractor runs in bfloat16 and neighbors are searched in float16; sums are float32.
    """

    def __init__(
        self, extractor: FeatureExtractor, weights: StyleWeights, scale: float, variation: str, gray: bool = False
    ) -> None:
        self.extractor, self.weights, self.scale, self.gray = extractor, weights, scale, gray
        self.variation = VARIATIONS[variation]
        self.device = extractor.input_scale.device
        on_gpu = self.device.type == "cuda"
        self.half, self.memory_mb = torch.bfloat16 if on_gpu else None, 1024.0 if on_gpu else 64.0

    def features_of(self, picture: Tensor, window: Window = EVERYTHING) -> dict[str, Tensor]:
        """Return features by block for a window of an image [3, h, w], at the feature scale."""
        part = picture[:, *window]
        if self.gray:
            part = part.mean(0, keepdim=True).expand(3, -1, -1)
        small = resized(part, *feature_size(part.shape[1], part.shape[2], self.scale))
        return by_block(self.extractor.layers, features(self.extractor, small[None], self.half))


def scaled_style(style_image: Tensor, size: tuple[int, int], scale: float, style_scale: float, stroke: float) -> Tensor:
    """Scale a style image [3 or 4, h, w] for content images of `size` (height, width); see StyleObjective."""
    return stroke_picture(style_image, max(1, round(max(size) * scale * style_scale)), stroke)


class StyleBlock(NamedTuple):
    """A style image's features of one block: rows to match, and the Gram matrix [c, c]."""

    rows: StyleRows
    gram: Tensor

    @classmethod
    def of(cls, feature: Tensor, most_rows: int, basis: int, seed: int) -> Self:
        """Create from features [c, h, w]."""
        rows = style_rows(feature, most_rows, seed=seed)
        return cls(rows.with_basis(basis) if 0 < basis < feature.shape[0] else rows, gram_matrix(feature))


class StyleObjective(FeatureLoss):
    """The loss of an image [3, h, w] for a style image whose features are computed once.

    Args:
        extractor: Its layers' features are matched.
        style_image: [3 or 4, h, w]; a fourth channel is alpha, and hidden parts are not matched.
        size: Height and width of the content images.
        weights: Of the loss terms.
        scale: Scale of the images that features are extracted from (ARF: 0.5).
        most_rows: Number of style features kept for matching.
        basis: Number of leading directions in which neighbors are searched; 0: all, exact.
        style_scale: Scale of the style image, relative to `scale`.
        strokes: Stroke sizes, relative to that; see style_features.stroke_picture(). If there are several, each pixel
            of an image selects one.
        rotations: Also match with the style image rotated by 90, 180 and 270 degrees.
        seed: For the choice of style features.
        variation: "squared" (ARF) or "diagonal" (DeSRF eq. 6).
        around: How many feature positions beyond the object also count.
        diversity: How evenly transport uses the style features; see style/transport.py.
        gray: Use features of the images' brightness, so that the loss does not change hues.

    Attributes:
        draw: Number of the step, which seeds the choice of positions.
    """

    def __init__(
        self,
        extractor: FeatureExtractor,
        style_image: Tensor,
        size: tuple[int, int],
        weights: StyleWeights,
        scale: float = 0.5,
        most_rows: int = 4096,
        basis: int = 96,
        style_scale: float = 1.0,
        seed: int = 0,
        variation: str = "squared",
        around: int = 0,
        diversity: float = 0.5,
        strokes: Sequence[float] = (1.0,),
        rotations: bool = False,
        gray: bool = False,
    ) -> None:
        super().__init__(extractor, weights, scale, variation, gray)
        self.around, self.diversity, self.draw = around, diversity, 0
        found = [self._features_of_style(style_image, size, style_scale, stroke, rotations, seed) for stroke in strokes]
        stroke = strokes[len(strokes) // 2]
        shown = min(1.0, GRADIENT_SIDE / (max(size) * style_scale * stroke))
        picture = scaled_style(style_image, size, shown, style_scale, stroke).to(self.device)
        self.gradients = {cell: style_gradients(picture, cell) for cell in (GRAIN_CELL, EDGE_CELL)}
        # Small cutouts have no deep features.
        found = [{block: feature for block, feature in one.items() if all(block in o for o in found)} for one in found]
        # Squared features of extractors differ by orders of magnitude, so content is relative to them (decision 0010).
        self.unit = {block: float(feature.square().mean().clamp_min(1e-12)) for block, feature in found[0].items()}
        self.styles = [
            {block: StyleBlock.of(feature, most_rows, basis, seed) for block, feature in one.items()} for one in found
        ]

    def _features_of_style(
        self, style_image: Tensor, size: tuple[int, int], style_scale: float, stroke: float, rotations: bool, seed: int
    ) -> dict[str, Tensor]:
        picture = scaled_style(style_image, size, self.scale, style_scale, stroke).to(self.device)
        return style_features(self.extractor, picture, self.half, rotations, in_parts=stroke > 1, seed=seed)

    def _style_distance(self, block: str, feature: Tensor, weights: Tensor | None, sizes: Tensor | None) -> Tensor:
        """Return the style distance of features [c, h, w] of one block; weights [h, w], indices into styles [h, w]."""
        if sizes is None:
            return self._distance(self.styles[0][block], feature, weights)
        distance, flat = feature.new_zeros(()), torch.ones_like(feature[0]) if weights is None else weights
        for at, style in enumerate(self.styles):
            places = torch.nonzero(sizes.flatten() == at)[:, 0]
            if len(places):
                part, counted = feature.flatten(1)[:, places][:, None], flat.flatten()[places][None]
                share = counted.sum() / flat.sum().clamp_min(1e-6)
                distance = distance + share * self._distance(style[block], part, counted, len(places) / flat.numel())
        return distance

    def _distance(self, style: StyleBlock, feature: Tensor, weights: Tensor | None, share: float = 1.0) -> Tensor:
        """Return the distance of features [c, h, w] to strokes of one size; weights [h, w]. share: of positions."""
        distance = self._distance_of_features(style, feature, weights, share)
        if self.weights.gram > 0:
            distance = distance + self.weights.gram / len(self.unit) * gram_difference(feature, style.gram, weights)
        return distance

    def _distance_of_features(
        self, style: StyleBlock, feature: Tensor, weights: Tensor | None, share: float
    ) -> Tensor:
        distances, _ = nearest_neighbor_distance(feature, style.rows, weights, self.memory_mb, self.half is not None)
        return distances.sum() / (distances.numel() if weights is None else weights.sum().clamp_min(1e-6))

    @torch.no_grad()
    def content_of(self, photo: Tensor, window: Window = EVERYTHING) -> Content:
        """Return the targets from a photo [3, h, w], in half precision, since they are kept for every view."""
        found = {block: f.half() for block, f in self.features_of(photo, window).items()}
        return Content(found, cell_colors(photo), self.edges_of(photo))

    @torch.no_grad()
    def edges_of(self, photo: Tensor) -> Tensor:
        """Return the edges of a photo [3, h, w] to keep, [2, h', w'], in half precision."""
        return possible_edges(luma_gradient(photo), self.gradients[EDGE_CELL]).half()

    def __call__(
        self,
        picture: Tensor,
        content: Content | None,
        alpha: Tensor | None = None,
        window: Window = EVERYTHING,
        sizes: Tensor | None = None,
    ) -> tuple[Tensor, dict[str, float]]:
        """Return the loss of an image and its terms.

        Args:
            picture: [3, h, w], over the background.
            content: Targets from the photo; None if unused (see StyleWeights.need_photo).
            alpha: [h, w], coverage by the object; everything else is ignored.
            window: The part that features are extracted from, the same as for `content` (see window_of()).
            sizes: [h, w] int, each pixel's index into `strokes`; None: the first.
        """
        found = self.features_of(picture, window)
        style_loss, content_loss = picture.new_zeros(()), picture.new_zeros(())
        for block in self.unit:
            feature = found[block]
            weights = None if alpha is None else position_weights(alpha[window], feature, self.around)
            total = feature[0].numel() if weights is None else weights.sum().clamp_min(1e-6)
            places = None if sizes is None else nearest_positions(sizes[window], feature)
            style_loss = style_loss + self._style_distance(block, feature, weights, places)
            if content is not None and self.weights.content > 0:
                apart = content_distance(feature, content.features[block].float()) / self.unit[block]
                content_loss = content_loss + (apart.mean() if weights is None else (apart * weights).sum() / total)
        variation = self.variation(picture)
        color_loss = picture.new_zeros(())
        if content is not None and self.weights.color > 0:
            apart = (cell_colors(picture) - content.colors).square().mean(0)
            weights = torch.ones_like(apart) if alpha is None else cell_colors(alpha[None])[0]
            # Empty views have zero weight: 0 instead of 0/0.
            color_loss = (apart * weights).sum() / weights.sum().clamp_min(1e-6)
        structure = picture.new_zeros(())
        if content is not None and self.weights.structure > 0:
            structure = missing_edges(picture, content.edges.to(picture), alpha)
        parts = {"style": style_loss, "content": content_loss, "variation": variation, "color": color_loss}
        parts["structure"] = structure
        if self.weights.grain > 0:
            parts["grain"] = grain(picture, self.gradients[GRAIN_CELL], alpha)
        return weighted_sum(self.weights, parts), {name: float(part.detach()) for name, part in parts.items()}


def weighted_sum(weights: StyleWeights, parts: Mapping[str, Tensor]) -> Tensor:
    """Return the weighted sum of the loss terms, added in order."""
    first, *rest = (getattr(weights, name) * part for name, part in parts.items())
    return sum(rest, first)


class GramObjective(StyleObjective):
    """StyleObjective with the distance of Gram matrices (Gatys et al. 2016) instead of nearest neighbors.

    The mean over blocks of sum (G - S)^2 / sum S^2, with G, S the Gram matrices of the image and the style image: 1 for
    an image without features, 0 for the style image, for any extractor (decision 0010). Blocks without coverage have
    distance 0.
    """

    def _distance_of_features(
        self, style: StyleBlock, feature: Tensor, weights: Tensor | None, share: float
    ) -> Tensor:
        if weights is not None and float(weights.sum()) <= 0:
            return feature.new_zeros(())
        apart = gram_distance(feature, style.gram, weights).sum() / style.gram.square().sum()
        return apart / len(self.unit)


class TransportObjective(StyleObjective):
    """StyleObjective with optimal transport instead of nearest neighbors (see style/transport.py).

    In each step, POSITIONS random positions of a block represent all of them.
    """

    def _distance_of_features(
        self, style: StyleBlock, feature: Tensor, weights: Tensor | None, share: float
    ) -> Tensor:
        rows, flat = rows_of(feature), None if weights is None else weights.flatten()
        positions = torch.arange(len(rows)) if flat is None else torch.nonzero(flat > 0)[:, 0].cpu()
        if len(positions) == 0:
            return feature.new_zeros(())
        most = max(1, round(POSITIONS * share))
        if len(positions) > most:
            order = torch.randperm(len(positions), generator=torch.Generator().manual_seed(self.draw))
            positions = positions[order[:most]]
        positions = positions.to(feature.device)
        found, chosen = unit_rows(rows[positions]), None if flat is None else flat[positions]
        targets = transport_targets(found, style.rows.rows, self.diversity, chosen)
        distances = 1 - (found * targets).sum(1)
        return distances.mean() if chosen is None else (distances * chosen).sum() / chosen.sum()


def window_of(alpha: np.ndarray, min_side: int = 0) -> Window:
    """Return the bounding box of the object in a view [h, w], plus a margin of 1/16 of the longer side and 8 pixels.

    Background costs the feature extractor as much as the object, to no effect. The margin allows for moving geometry
    and receptive fields. Sides are at multiples of 8 where possible, so that pooling is aligned with the whole view's.
    Returns the whole view if it is empty.

    Args:
        alpha: [h, w].
        min_side: Minimum side of the window, if the view is as large.
    """
    margin = round(max(alpha.shape) / 16) + 8
    sides = []
    for axis, length in ((1, alpha.shape[0]), (0, alpha.shape[1])):
        seen = np.flatnonzero((alpha > 0.01).any(axis))
        if len(seen) == 0:
            return EVERYTHING
        wide = max(margin, -(-(min_side - (seen[-1] + 1 - seen[0])) // 2))
        first, last = max(0, seen[0] - wide) // 8 * 8, min(length, -(-(seen[-1] + 1 + wide) // 8) * 8)
        # A window at the border is extended inwards.
        first = max(0, min(first, last - min_side))
        last = min(length, max(last, first + min_side))
        sides.append(slice(int(first), int(last)))
    return sides[0], sides[1]


def cell_colors(picture: Tensor) -> Tensor:
    """Return the mean colors of an image [c, h, w] in CELLS square cells along its longer side."""
    height, width = picture.shape[1:]
    # Images below CELLS pixels keep one cell per pixel.
    share = min(1.0, CELLS / max(height, width))
    return F.adaptive_avg_pool2d(picture, (max(1, round(height * share)), max(1, round(width * share))))
