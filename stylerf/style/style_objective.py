"""What a stylized view is asked to be: the painting's features, the photo's content, and smooth (ARF eq. 4); and where
the photo, in the painting's colors, is dark, bright or yellow, to stay so as a whole.
"""

from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from stylerf.style.feature_extractor import FeatureExtractor, features
from stylerf.style.feature_matching import StyleRows, style_rows
from stylerf.style.image_sizes import feature_size, resized, style_picture
from stylerf.style.losses import (
    by_block,
    content_distance,
    diagonal_variation,
    gram_distance,
    gram_matrix,
    image_variation,
    nearest_neighbor_distance,
    position_weights,
)

CELLS = 32  # of the longer side: the grain at which colors are kept
Window = tuple[slice, slice]  # rows and columns of a picture
EVERYTHING: Window = (slice(None), slice(None))
VARIATIONS = {"squared": image_variation, "diagonal": lambda picture: diagonal_variation(picture).mean()}


@dataclass(frozen=True)
class StyleWeights:
    """Weights of the mean nearest-neighbor distance, content distance, total variation and color distance.

    The content distance is counted in units of the painting's own mean squared feature: trunks differ ten thousandfold
    in their features' squares, so that a weight in the features' own units (ARF: 1e-3) means nothing without the trunk.
    The color distance is the mean squared difference of the mean colors of cells a 32nd of the picture wide: features
    hardly see color, which drifts where nothing holds it (docs/decisions/0012).
    """

    style: float = 1.0
    content: float = 1e-2
    variation: float = 1.0
    color: float = 10.0

    @property
    def need_photo(self) -> bool:
        """Whether anything of the photo is kept at all."""
        return self.content > 0 or self.color > 0


@dataclass(frozen=True)
class Content:
    """What a view keeps of its photo: features by block, and the mean colors of its cells [3, few, few]."""

    features: dict[str, Tensor]
    colors: Tensor

    @property
    def bytes(self) -> int:
        """Memory it takes."""
        return sum(t.numel() * t.element_size() for t in (*self.features.values(), self.colors))


class StyleObjective:
    """Loss of a picture [3, h, w] against a painting, with the painting's features computed once.

    Pictures, photos and alphas lie where the trunk does. On a GPU the trunk runs in bfloat16 and neighbors are sought
    among unit rows in float16; what is summed up is float32.

    scale: size of the picture that features are taken from (0.5: ARF). most_rows: style features kept for matching;
    basis: leading directions in which neighbors are sought (0: all, exact). variation: squared (ARF) or diagonal
    (DeSRF eq. 6, its mean over pixels). around: feature positions beside the object that count too.
    """

    def __init__(
        self,
        trunk: FeatureExtractor,
        painting: Tensor,
        size: tuple[int, int],
        weights: StyleWeights,
        scale: float = 0.5,
        most_rows: int = 4096,
        basis: int = 96,
        style_scale: float = 1.0,
        seed: int = 0,
        variation: str = "squared",
        around: int = 0,
    ) -> None:
        self.around = around
        self.variation = VARIATIONS[variation]
        self.trunk, self.weights, self.scale = trunk, weights, scale
        self.device = trunk.input_scale.device
        self.half, self.memory_mb = (torch.bfloat16, 1024.0) if self.device.type == "cuda" else (None, 64.0)
        picture = style_picture(painting, *size, scale=scale * style_scale).to(self.device)
        with torch.no_grad():
            found = by_block(trunk.taps, features(trunk, picture[None], self.half))
        self.style: dict[str, StyleRows] = {}
        self.unit = {block: float(feature.square().mean().clamp_min(1e-12)) for block, feature in found.items()}
        self._keep(found, most_rows, basis, seed)

    def _keep(self, found: dict[str, Tensor], most_rows: int, basis: int, seed: int) -> None:
        """What of the painting's features [c, h, w] pictures are set against."""
        for block, feature in found.items():
            rows = style_rows(feature, most_rows, seed=seed)
            self.style[block] = rows.with_basis(basis) if 0 < basis < feature.shape[0] else rows

    def _style_distance(self, block: str, feature: Tensor, weights: Tensor | None) -> Tensor:
        """Of one block of a picture's features [c, h, w]; weights [h, w]: where it counts."""
        distances, _ = nearest_neighbor_distance(
            feature, self.style[block], weights, self.memory_mb, self.half is not None
        )
        return distances.sum() / (distances.numel() if weights is None else weights.sum().clamp_min(1e-6))

    def features_of(self, picture: Tensor, window: Window = EVERYTHING) -> dict[str, Tensor]:
        """Features by block of a window of a picture [3, h, w], at the feature scale."""
        part = picture[:, *window]
        small = resized(part, *feature_size(*part.shape[1:], self.scale))
        return by_block(self.trunk.taps, features(self.trunk, small[None], self.half))

    @torch.no_grad()
    def content_of(self, photo: Tensor, window: Window = EVERYTHING) -> Content:
        """What a view is to keep of a photo [3, h, w]; features in half precision (it is held for every view)."""
        return Content({block: f.half() for block, f in self.features_of(photo, window).items()}, cell_colors(photo))

    def __call__(
        self, picture: Tensor, content: Content | None, alpha: Tensor | None = None, window: Window = EVERYTHING
    ) -> tuple[Tensor, dict[str, float]]:
        """(loss, its parts). alpha [h, w]: where the object is; what lies outside is neither matched nor kept.

        content: None where nothing is kept (StyleWeights.need_photo). window: features are taken from it alone (see
        window_of), the content's too.
        """
        found = self.features_of(picture, window)
        style_loss, content_loss = picture.new_zeros(()), picture.new_zeros(())
        for block, feature in found.items():
            weights = None if alpha is None else position_weights(alpha[window], feature, self.around)
            total = feature[0].numel() if weights is None else weights.sum().clamp_min(1e-6)
            style_loss = style_loss + self._style_distance(block, feature, weights)
            if content is not None and self.weights.content > 0:
                apart = content_distance(feature, content.features[block].float()) / self.unit[block]
                content_loss = content_loss + (apart.mean() if weights is None else (apart * weights).sum() / total)
        variation = self.variation(picture)
        color_loss = picture.new_zeros(())
        if content is not None and self.weights.color > 0:
            apart = (cell_colors(picture) - content.colors).square().mean(0)
            weights = torch.ones_like(apart) if alpha is None else cell_colors(alpha[None])[0]
            color_loss = (apart * weights).sum() / weights.sum().clamp_min(1e-6)
        parts = {"style": style_loss, "content": content_loss, "variation": variation, "color": color_loss}
        loss = sum(getattr(self.weights, name) * part for name, part in parts.items())
        return loss, {name: float(part.detach()) for name, part in parts.items()}


class GramObjective(StyleObjective):
    """The same with the distance of Gram matrices (Gatys et al. 2016) in the place of nearest neighbors.

    Per block, sum (G - S)^2 / sum S^2 with G, S the Gram matrices of the picture and the painting: 1 for a picture
    without features, 0 for the painting, whatever the trunk (docs/decisions/0010). What is summed up is their mean over
    blocks. Blocks whose coverage is nil are at distance 0.
    """

    def _keep(self, found: dict[str, Tensor], most_rows: int, basis: int, seed: int) -> None:
        self.grams = {block: gram_matrix(feature) for block, feature in found.items()}

    def _style_distance(self, block: str, feature: Tensor, weights: Tensor | None) -> Tensor:
        if weights is not None and float(weights.sum()) <= 0:
            return feature.new_zeros(())
        apart = gram_distance(feature, self.grams[block], weights).sum() / self.grams[block].square().sum()
        return apart / len(self.grams)


def window_of(alpha: np.ndarray, least: int = 0) -> Window:
    """The part of a view [h, w] that its object fills, with a margin of a 16th of the longer side and 8 pixels more.

    Most of a view of an object is background, which costs the trunk as much as the object does and counts for nothing.
    The margin is for shapes that move and for what a feature sees around it. Sides begin and end at multiples of 8,
    where the view has the room, so that pooled features lie as they would in the whole. least: pixels a side that it
    has at least, where the view has them. The whole view where nothing is seen.
    """
    margin = round(max(alpha.shape) / 16) + 8
    sides = []
    for axis, length in ((1, alpha.shape[0]), (0, alpha.shape[1])):
        seen = np.flatnonzero((alpha > 0.01).any(axis))
        if len(seen) == 0:
            return EVERYTHING
        wide = max(margin, -(-(least - (seen[-1] + 1 - seen[0])) // 2))
        first, last = max(0, seen[0] - wide) // 8 * 8, min(length, -(-(seen[-1] + 1 + wide) // 8) * 8)
        first = max(0, min(first, last - least))
        last = min(length, max(last, first + least))
        sides.append(slice(int(first), int(last)))
    return sides[0], sides[1]


def cell_colors(picture: Tensor) -> Tensor:
    """Mean colors of a picture [c, h, w] in CELLS cells along its longer side, as many for their size on the other."""
    height, width = picture.shape[1:]
    share = min(1.0, CELLS / max(height, width))
    return F.adaptive_avg_pool2d(picture, (max(1, round(height * share)), max(1, round(width * share))))
