"""The loss of a view given stylized references: content is matched to the references and takes on their style.

Ref-NPR's template-based correspondence (Zhang et al. 2023, section 3.3). Each reference view has a photo, which Ref-NPR
calls the template, and a stylized version. With F the features of a block:

    j(i) = argmin_j 1 - cos(F_photo,i , F_reference,j)           match content to the references' photos
    style = mean_i 1 - cos(F_render,i , F_stylized,j(i))         apply their style there
    color: the same for mean colors of coarse cells; matches with a cosine distance above 0.6 are ignored
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from stylerf.style.feature_extractor import FeatureExtractor, by_block, features
from stylerf.style.feature_matching import StyleRows, nearest, rows_of, sample, unit_rows
from stylerf.style.style_loss import (
    EVERYTHING,
    FeatureLoss,
    StyleWeights,
    Window,
    content_distance,
    nearest_neighbor_distance,
    position_weights,
    weighted_sum,
)

COARSE_PIXELS = 16  # maximum side of a coarse cell, pixels, if features are as fine (Ref-NPR: 1/16 of the image)
UNRELATED = 0.6  # cosine distance above which a coarse match is ignored (Ref-NPR)
MOST_ROWS = 16384  # reference features kept for matching

Matches = dict[str, Tensor]  # by block: [n] int32, for the positions inside alpha


@dataclass(frozen=True)
class ReferenceFeatures:
    """A reference view: photo and stylized image [3, h, w], alpha [h, w] or None, and the window to use."""

    photo: Tensor
    stylized: Tensor
    alpha: Tensor | None = None
    window: Window = EVERYTHING


@dataclass(frozen=True)
class Wanted:
    """Targets of a view.

    Attributes:
        matches: Matched reference positions, by block.
        content: The photo's features by block, in half precision.
        colors: [3, rows, columns], target colors of coarse cells.
        trusted: [rows, columns], coverage of cells with a usable match, 0 for others.
        covered: Sum of the coverage of all cells.
    """

    matches: Matches
    content: dict[str, Tensor]
    colors: Tensor
    trusted: Tensor
    covered: float

    @property
    def bytes(self) -> int:
        """Memory used, bytes."""
        held = (*self.matches.values(), *self.content.values(), self.colors, self.trusted)
        return sum(t.numel() * t.element_size() for t in held)


class ReferenceObjective(FeatureLoss):
    """The loss of an image [3, h, w] by its correspondences with references.

    Args:
        extractor: Its blocks are matched separately (Ref-NPR: conv3 and conv4).
        coarse: Its deepest block, at full resolution, finds the coarse matches (Ref-NPR: conv5).
        references: At least one.
        weights: Of the loss terms; content is relative to the mean squared feature of the stylized references
            (decision 0010).
        scale: Scale of the images that features are extracted from.
        basis: Leading directions in which matches are searched; 0 for all, exact.
        seed: Of the choice of reference features.
        variation: "squared" (ARF) or "diagonal" (DeSRF eq. 6).
    """

    def __init__(
        self,
        extractor: FeatureExtractor,
        coarse: FeatureExtractor,
        references: Sequence[ReferenceFeatures],
        weights: StyleWeights,
        scale: float = 0.5,
        basis: int = 96,
        seed: int = 0,
        variation: str = "squared",
    ) -> None:
        super().__init__(extractor, weights, scale, variation)
        self.coarse, self.references, self.basis, self.seed = coarse, list(references), basis, seed
        with torch.no_grad():
            stylized = self._rows_of([reference.stylized for reference in self.references])
            # keys and stylized are rows at the same positions: equal seeds and counts draw equal samples, so indices
            # are valid for both.
            self.stylized = {block: StyleRows(unit_rows(rows)) for block, rows in stylized.items()}
            self.unit = {block: float(rows.square().mean().clamp_min(1e-12)) for block, rows in stylized.items()}
            self.keys = self.keys_of([reference.photo for reference in self.references])
            cells = [self._cells(reference) for reference in self.references]
            self.coarse_keys = torch.cat([keys for keys, _ in cells])
            self.coarse_colors = torch.cat([colors for _, colors in cells])

    def _rows_of(self, pictures: Sequence[Tensor]) -> dict[str, Tensor]:
        """Return features by block, [n, c], of one image per reference, at positions inside its alpha."""
        found: dict[str, list[Tensor]] = {}
        for reference, picture in zip(self.references, pictures, strict=True):
            for block, feature in self.features_of(picture, reference.window).items():
                rows = rows_of(feature)
                if reference.alpha is not None:
                    rows = rows[position_weights(reference.alpha[reference.window], feature).flatten() > 0]
                found.setdefault(block, []).append(rows)
        joined = {block: torch.cat(parts) for block, parts in found.items()}
        return {b: sample(r, MOST_ROWS, self.seed) if len(r) > MOST_ROWS else r for b, r in joined.items()}

    @torch.no_grad()
    def keys_of(self, pictures: Sequence[Tensor]) -> dict[str, StyleRows]:
        """Return the references' features, by block, in which matches are searched; pictures: one per reference."""
        rows = {block: StyleRows(unit_rows(one)) for block, one in self._rows_of(pictures).items()}
        return {b: r.with_basis(self.basis) if 0 < self.basis < r.rows.shape[1] else r for b, r in rows.items()}

    @torch.no_grad()
    def matches_of(
        self, found: dict[str, Tensor], keys: dict[str, StyleRows], alpha: Tensor | None, window: Window
    ) -> Matches:
        """Match a view's features to the references, at positions inside alpha only."""
        matches = {}
        for block, feature in found.items():
            rows = rows_of(feature)
            if alpha is not None:
                rows = rows[position_weights(alpha[window], feature).flatten() > 0]
            matches[block] = keys[block].match(rows, self.memory_mb, self.half is not None).int()
        return matches

    def _cells(self, one: ReferenceFeatures) -> tuple[Tensor, Tensor]:
        """Return features [n, c] and stylized colors [n, 3] of a reference's coarse cells that show the object."""
        keys, size = self._coarse_features(one.photo, one.window)
        colors = rows_of(F.adaptive_avg_pool2d(one.stylized[:, *one.window], size))
        if one.alpha is not None:
            seen = F.adaptive_avg_pool2d(one.alpha[one.window][None], size).flatten() > 0.5
            if seen.any():
                keys, colors = keys[seen], colors[seen]
        return unit_rows(keys), colors

    def _coarse_features(self, photo: Tensor, window: Window) -> tuple[Tensor, tuple[int, int]]:
        """Return features [cells, c] of the coarse extractor's deepest block, and the grid's (rows, columns).

        Cells are at most COARSE_PIXELS wide, unless that exceeds the number of feature positions.
        """
        part = photo[:, *window]
        blocks = by_block(self.coarse.layers, features(self.coarse, part[None], self.half))
        feature = blocks[max(blocks)]
        rows, columns = (min(n, -(-side // COARSE_PIXELS)) for n, side in zip(feature.shape[1:], part.shape[1:]))
        return rows_of(F.adaptive_avg_pool2d(feature, (rows, columns))), (rows, columns)

    @torch.no_grad()
    def wanted(self, photo: Tensor, alpha: Tensor | None = None, window: Window = EVERYTHING) -> Wanted:
        """Return the targets of a view with photo [3, h, w]."""
        found = self.features_of(photo, window)
        keys, size = self._coarse_features(photo, window)
        place, cosine = nearest(keys, self.coarse_keys, self.memory_mb)
        trusted = (1 - cosine <= UNRELATED).float().reshape(size)
        covers = torch.ones_like(trusted)
        if alpha is not None:
            covers = F.adaptive_avg_pool2d(alpha[window][None], size)[0]
        colors = self.coarse_colors[place].T.reshape(3, *size)
        matches = self.matches_of(found, self.keys, alpha, window)
        content = {b: f.half() for b, f in found.items()}
        return Wanted(matches, content, colors, trusted * covers, float(covers.sum()))

    def __call__(
        self, picture: Tensor, wanted: Wanted, alpha: Tensor | None = None, window: Window = EVERYTHING
    ) -> tuple[Tensor, dict[str, float]]:
        """Return the loss of a rendered view [3, h, w], over the background, and its terms."""
        found = self.features_of(picture, window)
        style, content = self.style_distance(found, wanted.matches, alpha, window), picture.new_zeros(())
        for block, feature in found.items():
            weights = self._weights(feature, alpha, window)
            apart = content_distance(feature, wanted.content[block].float()) / self.unit[block]
            content = content + (apart * weights).sum() / weights.sum().clamp_min(1e-6)
        rows, columns = wanted.trusted.shape
        cells = F.adaptive_avg_pool2d(picture[:, *window], (rows, columns))
        apart = (cells - wanted.colors).square().mean(0)
        # Normalized by all covered cells, trusted or not, so that few matches have little influence.
        color = (apart * wanted.trusted).sum() / max(wanted.covered, 1e-6)
        parts = {"style": style, "content": content, "variation": self.variation(picture), "color": color}
        return weighted_sum(self.weights, parts), {name: float(part.detach()) for name, part in parts.items()}

    def style_distance(
        self, found: dict[str, Tensor], matches: Matches, alpha: Tensor | None, window: Window
    ) -> Tensor:
        """Return the mean over positions of 1 - cos(F_render,i , F_stylized,j(i)), summed over blocks."""
        total = torch.zeros((), device=self.device)
        for block, feature in found.items():
            weights = None if alpha is None else self._weights(feature, alpha, window)
            distances, _ = nearest_neighbor_distance(
                feature, self.stylized[block], weights, matches=matches[block].long()
            )
            total = total + distances.sum() / (distances.numel() if weights is None else weights.sum().clamp_min(1e-6))
        return total

    @staticmethod
    def _weights(feature: Tensor, alpha: Tensor | None, window: Window) -> Tensor:
        if alpha is None:
            return torch.ones_like(feature[0])
        return position_weights(alpha[window], feature)
