"""What a palette module came to on its views: shares of its colors, which of them stay, and its figures."""

import math

import numpy as np

from stylerf.editing.edit_views import EditView
from stylerf.editing.palette_losses import sparsity, weight_variation
from stylerf.editing.palette_module import PaletteModule

LEAST_SHARE = 0.025  # of the weights: a color with less is removed (LAENeRF, supplement 1.2)
ASKED_VIEWS = 10


def some_of(views: list[EditView]) -> list[EditView]:
    """Up to ASKED_VIEWS of the views, evenly. LAENeRF draws ten with replacement, which may be ten times one."""
    count = len(views)
    chosen = np.unique(np.linspace(0, count - 1, min(count, ASKED_VIEWS)).round().astype(int))
    return [views[at] for at in chosen]


def shares_of(module: PaletteModule, views: list[EditView], chunks: int) -> np.ndarray:
    """[A] mean weight of each active color: over the pixels of a view, then over up to ASKED_VIEWS views."""
    return np.mean([module.weights(view.x, chunks).mean(0) for view in some_of(views)], 0)


def kept_colors(active: np.ndarray, shares: np.ndarray, most: int) -> np.ndarray:
    """Which colors stay active, bool as `active`: of LEAST_SHARE or more, the `most` largest, and at least one.

    shares: [A] of the active ones.
    """
    order = np.argsort(-shares, kind="stable")
    chosen = [at for at in order[:most] if shares[at] >= LEAST_SHARE] or [order[0]]
    out = np.zeros_like(active)
    out[np.flatnonzero(active)[chosen]] = True
    return out


def figures_of(module: PaletteModule, views: list[EditView], chunks: int) -> dict:
    """JSON: colors and their shares, sparsity L_sp, palette TV, and PSNR in dB of the region's pixels against the
    photos, on up to ASKED_VIEWS views."""
    errors, sparse, varied, shares, pixels = 0.0, [], [], [], 0
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
