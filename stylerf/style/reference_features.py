"""What a view is asked to be where one or a few views are given stylized: the reference's look where its content is.

Ref-NPR's template-based correspondence (Zhang et al. 2023, section 3.3). Of each reference there are two pictures of
the same view: the template (its photo) and the stylized one. Symbols: F features of a block of the trunk.

    j(i) = argmin_j 1 - cos(F_photo,i , F_template,j)            content finds content
    style = mean_i 1 - cos(F_render,i , F_stylized,j(i))         and takes over the look that it has there
    color: the same in coarse cells, of their mean colors; a match at a cosine distance over 0.6 says nothing
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from stylerf.style.feature_extractor import FeatureExtractor, features
from stylerf.style.feature_matching import StyleRows, nearest, rows_of, sample, unit_rows
from stylerf.style.image_sizes import feature_size, resized
from stylerf.style.losses import by_block, content_distance, nearest_neighbor_distance, position_weights
from stylerf.style.style_objective import EVERYTHING, VARIATIONS, StyleWeights, Window

COARSE_PIXELS = 16  # of the picture, a coarse cell's side (Ref-NPR: 1/16 of its size)
STRANGE = 0.6  # cosine distance over which a coarse match says nothing (Ref-NPR)
MOST_ROWS = 16384  # features of the references that are matched against

Matches = dict[str, Tensor]  # by block: [n] int32, for the positions that count


@dataclass(frozen=True)
class ReferenceFeatures:
    """A reference view: its photo and its stylized picture, [3, h, w]; alpha [h, w] or None; the window that counts."""

    photo: Tensor
    stylized: Tensor
    alpha: Tensor | None = None
    window: Window = EVERYTHING


@dataclass(frozen=True)
class Wanted:
    """What a view is asked to be: matches, the photo's features by block (half precision), colors of coarse cells.

    colors: [3, few, few]. trusted: [few, few], 1 where a cell's match says something, times its coverage. covered: the
    coverage of all cells together.
    """

    matches: Matches
    content: dict[str, Tensor]
    colors: Tensor
    trusted: Tensor
    covered: float

    @property
    def bytes(self) -> int:
        """Memory it takes."""
        held = (*self.matches.values(), *self.content.values(), self.colors, self.trusted)
        return sum(t.numel() * t.element_size() for t in held)


class ReferenceObjective:
    """Loss of a picture [3, h, w] by its correspondences with the references.

    trunk: its taps' blocks are matched, each by itself (Ref-NPR: conv3 and conv4). coarse: a trunk whose deepest
    block finds coarse matches (Ref-NPR: conv5), in pictures of full size. weights: style, content in the mean square of
    the stylized pictures' features (docs/decisions/0010), variation, coarse color. scale: size of the picture that
    features are taken from.
    """

    def __init__(
        self,
        trunk: FeatureExtractor,
        coarse: FeatureExtractor,
        templates: Sequence[ReferenceFeatures],
        weights: StyleWeights,
        scale: float = 0.5,
        basis: int = 96,
        seed: int = 0,
        variation: str = "squared",
    ) -> None:
        self.trunk, self.coarse, self.weights, self.scale = trunk, coarse, weights, scale
        self.templates, self.basis, self.seed = list(templates), basis, seed
        self.variation = VARIATIONS[variation]
        self.device = trunk.input_scale.device
        self.half, self.memory_mb = (torch.bfloat16, 1024.0) if self.device.type == "cuda" else (None, 64.0)
        with torch.no_grad():
            stylized = self._rows_of([t.stylized for t in self.templates])
            self.stylized = {block: StyleRows(unit_rows(rows)) for block, rows in stylized.items()}
            self.unit = {block: float(rows.square().mean().clamp_min(1e-12)) for block, rows in stylized.items()}
            self.keys = self.keys_of([t.photo for t in self.templates])
            cells = [self._cells(t) for t in self.templates]
            self.coarse_keys = torch.cat([keys for keys, _ in cells])
            self.coarse_colors = torch.cat([colors for _, colors in cells])

    def features_of(self, picture: Tensor, window: Window = EVERYTHING) -> dict[str, Tensor]:
        """Features by block of a window of a picture [3, h, w], at the feature scale."""
        part = picture[:, *window]
        small = resized(part, *feature_size(*part.shape[1:], self.scale))
        return by_block(self.trunk.taps, features(self.trunk, small[None], self.half))

    def _rows_of(self, pictures: Sequence[Tensor]) -> dict[str, Tensor]:
        """Features by block, [n, c], of one picture a reference, where it counts: the same positions of each kind."""
        found: dict[str, list[Tensor]] = {}
        for template, picture in zip(self.templates, pictures, strict=True):
            for block, feature in self.features_of(picture, template.window).items():
                rows = rows_of(feature)
                if template.alpha is not None:
                    rows = rows[position_weights(template.alpha[template.window], feature).flatten() > 0]
                found.setdefault(block, []).append(rows)
        rows = {block: torch.cat(parts) for block, parts in found.items()}
        return {b: sample(r, MOST_ROWS, self.seed) if len(r) > MOST_ROWS else r for b, r in rows.items()}

    @torch.no_grad()
    def keys_of(self, pictures: Sequence[Tensor]) -> dict[str, StyleRows]:
        """What matches are sought among, by block: features of the references as `pictures` show them."""
        rows = {block: StyleRows(unit_rows(one)) for block, one in self._rows_of(pictures).items()}
        return {b: r.with_basis(self.basis) if 0 < self.basis < r.rows.shape[1] else r for b, r in rows.items()}

    @torch.no_grad()
    def matches_of(
        self, found: dict[str, Tensor], keys: dict[str, StyleRows], alpha: Tensor | None, window: Window
    ) -> Matches:
        """The reference's position of each of a view's, by its features; of those that count alone."""
        matches = {}
        for block, feature in found.items():
            rows = rows_of(feature)
            if alpha is not None:
                rows = rows[position_weights(alpha[window], feature).flatten() > 0]
            matches[block] = keys[block].match(rows, self.memory_mb, self.half is not None).int()
        return matches

    def _cells(self, one: ReferenceFeatures) -> tuple[Tensor, Tensor]:
        """(features [n, c], stylized colors [n, 3]) of a reference's coarse cells that see the object."""
        keys, size = self._coarse_features(one.photo, one.window)
        colors = rows_of(F.adaptive_avg_pool2d(one.stylized[:, *one.window], size))
        if one.alpha is not None:
            seen = F.adaptive_avg_pool2d(one.alpha[one.window][None], size).flatten() > 0.5
            if seen.any():
                keys, colors = keys[seen], colors[seen]
        return unit_rows(keys), colors

    def _coarse_features(self, photo: Tensor, window: Window) -> tuple[Tensor, tuple[int, int]]:
        """([cells, c], (rows, columns)) of the coarse trunk's deepest block, a cell COARSE_PIXELS wide or wider."""
        part = photo[:, *window]
        blocks = by_block(self.coarse.taps, features(self.coarse, part[None], self.half))
        feature = blocks[max(blocks)]
        size = tuple(min(n, -(-length // COARSE_PIXELS)) for n, length in zip(feature.shape[1:], part.shape[1:]))
        return rows_of(F.adaptive_avg_pool2d(feature, size)), size

    @torch.no_grad()
    def wanted(self, photo: Tensor, alpha: Tensor | None = None, window: Window = EVERYTHING) -> Wanted:
        """What the view of a photo [3, h, w] is asked to be."""
        found = self.features_of(photo, window)
        keys, size = self._coarse_features(photo, window)
        place, cosine = nearest(keys, self.coarse_keys, self.memory_mb)
        trusted = (1 - cosine <= STRANGE).float().reshape(size)
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
        """(loss, its parts) of a view's picture over the background."""
        found = self.features_of(picture, window)
        style, content = self.style_distance(found, wanted.matches, alpha, window), picture.new_zeros(())
        for block, feature in found.items():
            weights = self._weights(feature, alpha, window)
            apart = content_distance(feature, wanted.content[block].float()) / self.unit[block]
            content = content + (apart * weights).sum() / weights.sum().clamp_min(1e-6)
        cells = F.adaptive_avg_pool2d(picture[:, *window], wanted.trusted.shape)
        apart = (cells - wanted.colors).square().mean(0)
        color = (apart * wanted.trusted).sum() / max(wanted.covered, 1e-6)
        parts = {"style": style, "content": content, "variation": self.variation(picture), "color": color}
        loss = sum(getattr(self.weights, name) * part for name, part in parts.items())
        return loss, {name: float(part.detach()) for name, part in parts.items()}

    def style_distance(
        self, found: dict[str, Tensor], matches: Matches, alpha: Tensor | None, window: Window
    ) -> Tensor:
        """Mean over positions of 1 - cos(F_render,i , F_stylized,j(i)), summed over blocks."""
        total = 0.0
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
