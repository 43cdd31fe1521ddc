"""LAENeRF's losses for a palette module, its metrics, and pruning of its colors.

The released code sums most of them over the pixels of a view, so its weights suit one resolution. Here they are means
over pixels, or otherwise independent of resolution; REFERENCE_PIXELS converts published weights of sums.

c: colors [n, 3]; t: the photo's colors; w: weights [n, A]; o: offsets [n, 3]; P: palette [A, 3]; C: the image of a
view, whose pairs are vertical and horizontal neighbors; zeta: geometry edges; lambda: transition, 1 at the region's
border with its surroundings.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from stylerf.editing.extraction import EditView
from stylerf.editing.palette_module import PaletteEvaluator
from stylerf.geometry.cameras import evenly_spaced

REFERENCE_PIXELS = 1e5  # pixels of a region at the resolutions for which the published weights were chosen


@dataclass(frozen=True)
class EditWeights:
    """Weights of the loss terms.

    reconstruction: L_rec. certainty: L_weight. uniform: L_uniform. offset: L_offset. valid: L_valid. distinct:
    L_distinct. While a style image is learned: style: L_style, variation: L_TV, edges: L_disc, smooth: L_smooth.

    Published, converted to means: certainty 1e-2, offset 5, the last three as here. On the front of the lego scene (400
    steps, initially 8 colors) these result in 3 colors and 27.3 dB; 5e-3 and 0.5 in 5 colors, L_sp 0.75 and 32.6 dB.
    LAENeRF reports L_sp 0.859 with 5 colors for lego's shovel. style has its own unit (see RegionStyle), so LAENeRF's
    130 does not apply.
    """

    reconstruction: float = 1.0
    certainty: float = 5e-3
    uniform: float = 0.0
    offset: float = 0.5
    valid: float = 1.0
    distinct: float = 0.0
    style: float = 1.0
    variation: float = 1e-4 * REFERENCE_PIXELS
    edges: float = 5e-4 * REFERENCE_PIXELS
    smooth: float = 1e-3 * REFERENCE_PIXELS


# -- losses of pixels ------------------------------------------------------------------------------------------------


def reconstruction(colors: Tensor, target: Tensor) -> Tensor:
    """Return L_rec per pixel, [n]: mean over channels of (c - t)^2."""
    return (colors - target).square().mean(1)


def uncertainty(weights: Tensor) -> Tensor:
    """Return L_weight per pixel, [n] in 0..1 - 1/A: 1 - max_j w_j."""
    return 1 - weights.amax(1)


def largest_share(weights: Tensor) -> Tensor:
    """Return L_uniform, a scalar in 1/A..1: max_j of the mean of w_j; prevents one color from taking over."""
    return weights.mean(0).max()


def offset_size(offsets: Tensor) -> Tensor:
    """Return L_offset per pixel, [n]: |o|^2."""
    return offsets.square().sum(1)


def outside_gamut(palette: Tensor) -> Tensor:
    """Return L_valid, a scalar: sum of floor(P) P, 0 for P in [0, 1). No gradient through the floor."""
    # floor is -1 below 0 and 1 in 1..2, so the gradient pulls inwards from both sides.
    return (palette.detach().floor() * palette).sum()


def likeness(palette: Tensor) -> Tensor:
    """Return L_distinct, a scalar: mean over all pairs jk of 1 - |P_j - P_k|^2 / max; 1 if all colors are equal."""
    apart = (palette[:, None] - palette).square().sum(-1)
    return (1 - apart / apart.max().clamp_min(1e-12)).mean()


# -- losses of a view's image ----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Neighbors:
    """The pairs of neighboring pixels in a view, as tensors.

    Attributes:
        first, second: [m], indices of their pixels.
        edges: [m], zeta divided by the view's largest along the same axis, 0..1.
        transition: [m] lambda of the second pixel.
        pixels: n.
    """

    first: Tensor
    second: Tensor
    edges: Tensor
    transition: Tensor
    pixels: int

    @classmethod
    def of(cls, view: EditView, device: torch.device | str = "cpu") -> "Neighbors":
        upper, lower, left, right = view.pairs()
        first, second = np.concatenate([upper, left]), np.concatenate([lower, right])
        # LAENeRF's code uses the unbounded zeta in L_TV, and zeta divided by its maximum in L_disc.
        edges = [view.edges[some, axis] / max(float(view.edges[:, axis].max()), 1e-12)
                 for axis, some in enumerate((upper, left))]  # fmt: skip

        def there(values: np.ndarray) -> Tensor:
            return torch.from_numpy(values).to(device)

        zeta, transition = np.concatenate(edges).astype(np.float32), view.transition[second].astype(np.float32)
        return cls(there(first), there(second), there(zeta), there(transition), len(view))

    def differences(self, colors: Tensor) -> Tensor:
        """Return the sum over channels of (C_i - C_{i+1})^2 for each pair, [m]."""
        # The gradient of index_select is deterministic, unlike that of indexing.
        return (colors.index_select(0, self.first) - colors.index_select(0, self.second)).square().sum(1)


def variation(differences: Tensor, neighbors: Neighbors) -> Tensor:
    """Return L_TV, a scalar: sum over pairs of (C_i - C_{i+1})^2 (1 - zeta) (1 - lambda), / REFERENCE_PIXELS.

    Doubling the resolution halves the differences and quadruples their number, so the sum is independent of it.
    """
    return (differences * (1 - neighbors.edges) * (1 - neighbors.transition)).sum() / REFERENCE_PIXELS


def edge_contrast(differences: Tensor, neighbors: Neighbors) -> Tensor:
    """Return L_disc, a scalar <= 0: minus the sum over pairs of (C_i - C_{i+1})^2 zeta, / sqrt(n REFERENCE_PIXELS).

    Color steps at geometry edges do not depend on resolution, while the number of pairs across an edge is proportional
    to it.
    """
    return -(differences * neighbors.edges).sum() / (neighbors.pixels * REFERENCE_PIXELS) ** 0.5


def transition_error(colors: Tensor, target: Tensor, transition: Tensor) -> Tensor:
    """Return L_smooth per pixel, [n]: lambda times the sum over channels of (C - t)^2."""
    return transition * (colors - target).square().sum(1)


# -- metrics ---------------------------------------------------------------------------------------------------------


def sparsity(weights: np.ndarray) -> float:
    """Return L_sp, the mean over pixels of (sum w / sum w^2 - 1) for weights [n, A] (supplement, eq. 2).

    0 if every pixel has a single color or there are no pixels; A - 1 if all weights are equal.
    """
    squares = np.square(weights, dtype=np.float64).sum(1)
    return float((weights.sum(1, dtype=np.float64) / squares - 1).mean()) if len(weights) else 0.0


def weight_variation(weights: np.ndarray, view: EditView) -> float:
    """Return the palette TV of a view: sum over pairs ij and weights [n, A] of ((w_i - w_j) a_i a_j)^2, / n.

    a: alpha of the field. As in LAENeRF's released code, which measures it during distillation of the edit.
    """
    upper, lower, left, right = view.pairs()
    first, second = np.concatenate([upper, left]), np.concatenate([lower, right])
    differences = np.square(weights[first].astype(np.float64) - weights[second]).sum(1)
    gates = view.weight[first].astype(np.float64) * view.weight[second]
    return float((differences * gates**2).sum() / max(len(view), 1))


MIN_SHARE = 0.025  # mean weight below which a color is pruned (LAENeRF, supplement 1.2)
SAMPLED_VIEWS = 10


def some_of(views: list[EditView]) -> list[EditView]:
    """Return up to SAMPLED_VIEWS views, evenly spaced (LAENeRF draws ten with replacement)."""
    return [views[at] for at in evenly_spaced(len(views), SAMPLED_VIEWS)]


def shares_of(module: PaletteEvaluator, views: list[EditView], threads: int) -> np.ndarray:
    """Return the mean weight of each active color, [A], averaged over a view's pixels and then over sampled views."""
    return np.asarray(np.mean([module.weights(view.x, threads).mean(0) for view in some_of(views)], 0))


def kept_colors(active: np.ndarray, shares: np.ndarray, most: int) -> np.ndarray:
    """Choose the colors that stay active: the `most` largest with at least MIN_SHARE, and at least one.

    Args:
        active: [colors] bool.
        shares: [A], mean weights of the active colors.
        most: Maximum number of colors.

    Returns:
        [colors] bool.
    """
    # Stable, so that equal shares keep the palette's order on every machine.
    order = np.argsort(-shares, kind="stable")
    chosen = [at for at in order[:most] if shares[at] >= MIN_SHARE] or [order[0]]
    out = np.zeros_like(active)
    out[np.flatnonzero(active)[chosen]] = True
    return out


def figures_of(module: PaletteEvaluator, views: list[EditView], threads: int) -> dict[str, Any]:
    """Return metrics on sampled views as JSON: colors, mean weights, sparsity L_sp, palette TV, and PSNR (dB)."""
    errors, pixels = 0.0, 0
    sparse: list[float] = []
    varied: list[float] = []
    shares: list[np.ndarray] = []
    for view in some_of(views):
        mixture = module.mixture(view.x, view.directions, threads)
        weights = mixture.weights.numpy()
        errors += float(np.square(mixture.colors.numpy() - view.target, dtype=np.float64).sum())
        pixels += len(view)
        sparse.append(sparsity(weights))
        varied.append(weight_variation(weights, view))
        shares.append(weights.mean(0))
    return figures_json(module.palette, shares, sparse, varied, errors / (3 * pixels))


def figures_json(
    palette: np.ndarray, shares: list[np.ndarray], sparse: list[float], varied: list[float], error: float
) -> dict[str, Any]:
    """Return the metrics of a palette as JSON, from each view's mean weights, L_sp and palette TV, and the MSE."""
    return {
        "colors": len(palette),
        "palette": [[round(float(v), 4) for v in color] for color in palette],
        "shares": [round(float(share), 4) for share in np.mean(shares, 0)],
        "sparsity": round(float(np.mean(sparse)), 4),
        "palette_variation": round(float(np.mean(varied)), 5),
        "psnr": round(-10 * math.log10(max(error, 1e-10)), 2),
    }
