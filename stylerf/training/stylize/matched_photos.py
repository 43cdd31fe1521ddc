"""Match the colors of photos and of renders to a style image's, weighted by the coverage of the object."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from stylerf.fields.radiance_field import ColorMap
from stylerf.rendering.ray_registration import SOLID
from stylerf.style.color_matching import match_colors, pixels_of


@dataclass(frozen=True, eq=False)
class ObjectPhotos:
    """Photos without their background.

    Attributes:
        photos: [h, w, 3] over the background.
        alpha: Coverage of a view, [h, w], before anything moves.
        background: Gray level; None: a region is covered, and the photos stay as they are beside it.
    """

    photos: Sequence[np.ndarray]
    alpha: Callable[[int], np.ndarray]
    background: np.float32 | None

    def __call__(self, view: int) -> tuple[np.ndarray, np.ndarray]:
        """Premultiplied rgb [h, w, 3] without the background, and its coverage [h, w]."""
        coverage = self.alpha(view)
        behind = (1 - coverage[..., None]) * self._beside(view)
        return np.clip(self.photos[view] - behind, 0, coverage[..., None]), coverage

    def _beside(self, view: int) -> np.ndarray | np.float32:
        return self.photos[view] if self.background is None else self.background

    def colors(self, seed: int, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """A sample of their colors [n, 3] and weights [n]. count: number of pixels of all photos."""
        straight = (straight_rgba(*self(view)) for view in range(len(self.photos)))
        return pixels_of(straight, seed=seed, count=count)

    def mapped(self, view: int, color_map: ColorMap) -> np.ndarray:
        """A photo with the object's colors mapped, [h, w, 3]; the background stays."""
        rgb, coverage = self(view)
        mapped = color_map.premultiplied(torch.from_numpy(rgb), torch.from_numpy(coverage)).numpy()
        level = coverage[..., None]
        return (np.clip(mapped, 0, level) + (1 - level) * self._beside(view)).astype(np.float32)


def straight_rgba(rgb: np.ndarray, coverage: np.ndarray, threshold: float = 0.0) -> torch.Tensor:
    """[4, h, w] float32 of premultiplied rgb [h, w, 3]; alpha 0 where the coverage is at most `threshold`."""
    alpha = coverage[..., None]
    rgba = np.concatenate([rgb / np.maximum(alpha, 1e-3), np.where(alpha > threshold, alpha, 0)], -1)
    return torch.from_numpy(rgba.astype(np.float32)).permute(2, 0, 1)


def rendered_match(
    pictures: Iterable[tuple[np.ndarray, np.ndarray]],  # premultiplied rgb [h, w, 3], alpha [h, w]
    style_image: torch.Tensor,
    seed: int,
) -> ColorMap:
    """The map from renders' colors to the style image's (ARF's last step).

    Pixels that are half covered or less do not count, unless there are no others: in haze, or of rods thinner than a
    pixel.
    """
    seen = [straight_rgba(*picture) for picture in pictures]
    if any(bool((rgba[3] > SOLID).any()) for rgba in seen):
        for rgba in seen:
            rgba[3][rgba[3] <= SOLID] = 0
    colors, weights = pixels_of(seen, seed=seed)
    return match_colors(colors.clamp(0, 1), style_image.flatten(1).T, weights)
