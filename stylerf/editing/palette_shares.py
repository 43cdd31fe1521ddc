"""Mean weights of a palette module's colors on its views, pruning of colors, and metrics."""

import math
from typing import Any

import numpy as np

from stylerf.editing.edit_views import EditView
from stylerf.editing.palette_losses import sparsity, weight_variation
from stylerf.editing.palette_module import PaletteModule

LEAST_SHARE = 0.025  # mean weight below which a color is pruned (LAENeRF, supplement 1.2)
SAMPLED_VIEWS = 10


def some_of(views: list[EditView]) -> list[EditView]:
    """Return up to SAMPLED_VIEWS views, evenly spaced (LAENeRF draws ten with replacement)."""
    count = len(views)
    chosen = np.unique(np.linspace(0, count - 1, min(count, SAMPLED_VIEWS)).round().astype(int))
    return [views[at] for at in chosen]


def shares_of(module: PaletteModule, views: list[EditView], chunks: int) -> np.ndarray:
    """Return the mean weight [A] of each active color, over the pixels of a view and then over sampled views."""
    return np.asarray(np.mean([module.weights(view.x, chunks).mean(0) for view in some_of(views)], 0))


def kept_colors(active: np.ndarray, shares: np.ndarray, most: int) -> np.ndarray:
    """Choose the colors that stay active: the `most` largest of at least LEAST_SHARE, and at least one.

    Args:
        active: [colors] bool.
        shares: [A], mean weights of the active colors.
        most: Largest number of colors.

    Returns:
        [colors] bool.
    """
    order = np.argsort(-shares, kind="stable")
    chosen = [at for at in order[:most] if shares[at] >= LEAST_SHARE] or [order[0]]
    out = np.zeros_like(active)
    out[np.flatnonzero(active)[chosen]] = True
    return out


def figures_of(module: PaletteModule, views: list[EditView], chunks: int) -> dict[str, Any]:
    """Return metrics on sampled views as JSON: colors, mean weights, sparsity L_sp, palette TV, and PSNR (dB)."""
    errors, pixels = 0.0, 0
    sparse: list[float] = []
    varied: list[float] = []
    shares: list[np.ndarray] = []
    for view in some_of(views):
        mixture = module.mixture(view.x, view.directions, chunks)
        weights = mixture.weights.numpy()
        errors += float(np.square(mixture.colors.numpy() - view.target, dtype=np.float64).sum())
        pixels += len(view)
        sparse.append(sparsity(weights))
        varied.append(weight_variation(weights, view))
        shares.append(weights.mean(0))
    return {
        "colors": int(module.active.sum()),
        "palette": [[round(float(v), 4) for v in color] for color in module.palette],
        "shares": [round(float(share), 4) for share in np.mean(shares, 0)],
        "sparsity": round(float(np.mean(sparse)), 4),
        "palette_variation": round(float(np.mean(varied)), 5),
        "psnr": round(-10 * math.log10(max(errors / (3 * pixels), 1e-10)), 2),
    }
