"""Colours of photos and of rendered views brought to a painting's, weighted by what of them is object."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np
import torch

from stylerf.style.colour import ColourMap, match_colours, pixels_of


def matched_photos(
    photos: Sequence[np.ndarray],  # [h, w, 3] over the background
    alpha: Callable[[int], np.ndarray],  # [h, w]: the field's own coverage of a view, before anything moves
    background: np.float32,
    painting: torch.Tensor,  # [3, h, w]
    seed: int,
    count: int,  # pixels of all photos
) -> Callable[[int], np.ndarray]:
    """The photos in the painting's colours, by one map for all of them; the background stays as it is."""

    def object_of(view: int) -> tuple[np.ndarray, np.ndarray]:
        """Premultiplied rgb [h, w, 3] of what is not background, and its coverage."""
        coverage = alpha(view)
        behind = (1 - coverage[..., None]) * background
        return np.clip(photos[view] - behind, 0, coverage[..., None]), coverage

    straight = (straight_rgba(*object_of(view)) for view in range(len(photos)))
    colours, weights = pixels_of(straight, seed=seed, count=count)
    colour_map = match_colours(colours, painting.flatten(1).T, weights)

    def matched(view: int) -> np.ndarray:
        rgb, coverage = object_of(view)
        mapped = colour_map.premultiplied(torch.from_numpy(rgb), torch.from_numpy(coverage)).numpy()
        level = coverage[..., None]
        return (np.clip(mapped, 0, level) + (1 - level) * background).astype(np.float32)

    return matched


def straight_rgba(rgb: np.ndarray, coverage: np.ndarray, least: float = 0.0) -> torch.Tensor:
    """[4, h, w] float32 of premultiplied rgb [h, w, 3]; alpha 0 where the coverage is `least` or less."""
    alpha = coverage[..., None]
    rgba = np.concatenate([rgb / np.maximum(alpha, 1e-3), np.where(alpha > least, alpha, 0)], -1)
    return torch.from_numpy(rgba.astype(np.float32)).permute(2, 0, 1)


def rendered_match(
    pictures: Iterable[tuple[np.ndarray, np.ndarray]],  # premultiplied rgb [h, w, 3], alpha [h, w]
    painting: torch.Tensor,
    seed: int,
) -> ColourMap:
    """The map from rendered views' colours to the painting's (ARF's last step); half-covered pixels do not count."""
    colours, weights = pixels_of([straight_rgba(*picture, least=0.5) for picture in pictures], seed=seed)
    return match_colours(colours.clamp(0, 1), painting.flatten(1).T, weights)
