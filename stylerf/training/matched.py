"""Colours of photos and of rendered views brought to a painting's, weighted by what of them is object."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np
import torch

from stylerf.style.colour import ColourMap, match_colours, pixels_of


def over(rgb: np.ndarray, alpha: np.ndarray, background: np.float32) -> np.ndarray:
    """Straight rgb [h, w, 3] of coverage alpha [h, w] over a level of grey, float32."""
    return (rgb * alpha[..., None] + (1 - alpha[..., None]) * background).astype(np.float32)


def matched_photos(
    photos: Sequence[np.ndarray],  # [h, w, 3] over the background
    alpha: Callable[[int], np.ndarray],  # [h, w]: the field's own coverage of a view, before anything moves
    background: np.float32,
    painting: torch.Tensor,  # [3, h, w]
    seed: int,
    count: int,  # pixels of all photos
) -> Callable[[int], np.ndarray]:
    """The photos in the painting's colours, by one map for all of them; the background stays as it is."""

    def rgba(view: int) -> torch.Tensor:
        return torch.from_numpy(np.concatenate([photos[view], alpha(view)[..., None]], -1)).permute(2, 0, 1)

    colours, weights = pixels_of((rgba(view) for view in range(len(photos))), seed=seed, count=count)
    colour_map = match_colours(colours, painting.flatten(1).T, weights)

    def matched(view: int) -> np.ndarray:
        one = rgba(view)
        return over(colour_map.image(one[:3]).permute(1, 2, 0).numpy(), one[3].numpy(), background)

    return matched


def rendered_match(
    pictures: Iterable[tuple[np.ndarray, np.ndarray]],  # premultiplied rgb [h, w, 3], alpha [h, w]
    painting: torch.Tensor,
    seed: int,
) -> ColourMap:
    """The map from rendered views' colours to the painting's (ARF's last step); half-covered pixels do not count."""
    stacked = []
    for rgb, coverage in pictures:
        alpha = coverage[..., None]
        rgba = np.concatenate([rgb / np.maximum(alpha, 1e-3), np.where(alpha > 0.5, alpha, 0)], -1)
        stacked.append(torch.from_numpy(rgba.astype(np.float32)).permute(2, 0, 1))
    colours, weights = pixels_of(stacked, seed=seed)
    return match_colours(colours.clamp(0, 1), painting.flatten(1).T, weights)
