"""LAENeRF's losses of a palette module, and how sparse and how smooth its weights are.

The released code adds most of them up over the pixels of a view, so that its weights hold for one resolution. Here each
is a mean over pixels, or is counted so that the same picture at another size gives the same: a published weight of a
sum becomes that of a mean by REFERENCE_PIXELS.

c: colors [n, 3]; t: what the photo shows; w: weights [n, A]; o: offsets [n, 3]; P: palette [A, 3]; C: the picture of
one view, whose pairs are neighboring pixels (below each other, beside each other); zeta: geometry edges; lambda:
transition, 1 where the region meets what surrounds it.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from stylerf.editing.edit_views import EditView

REFERENCE_PIXELS = 1e5  # pixels of a region at the resolutions for which the published weights were chosen


@dataclass(frozen=True)
class EditWeights:
    """Weights of the parts. Published, with sums turned to means: certainty 1e-2, offset 5, the last three as here.

    reconstruction: L_rec. certainty: L_weight. uniform: L_uniform. offset: L_offset. valid: L_valid. distinct:
    L_distinct. style, variation, edges, smooth: L_style, L_TV, L_disc, L_smooth, while an image is learned.

    certainty and offset by measurement (front of the lego scene, 400 steps, 8 colors at first): the published ones
    leave 3 colors and 27.3 dB of the region; 5e-3 and 0.5 leave 5 with L_sp 0.75 and 32.6 dB. Published L_sp of lego's
    shovel: 0.859 with 5. style is in units of its own (see RegionStyle), where LAENeRF's 130 says nothing.
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


# -- of pixels ------------------------------------------------------------------------------------------------------


def reconstruction(colors: Tensor, target: Tensor) -> Tensor:
    """L_rec per pixel, [n]: mean over channels of (c - t)^2."""
    return (colors - target).square().mean(1)


def uncertainty(weights: Tensor) -> Tensor:
    """L_weight per pixel, [n] in 0..1 - 1/A: 1 - max_j w_j."""
    return 1 - weights.amax(1)


def largest_share(weights: Tensor) -> Tensor:
    """L_uniform, scalar in 1/A..1: max_j of the mean of w_j; holds back a color that takes everything."""
    return weights.mean(0).max()


def offset_size(offsets: Tensor) -> Tensor:
    """L_offset per pixel, [n]: |o|^2."""
    return offsets.square().sum(1)


def outside_gamut(palette: Tensor) -> Tensor:
    """L_valid, scalar: sum of floor(P) P, 0 where P lies in [0, 1). The floor is a constant."""
    return (palette.detach().floor() * palette).sum()


def likeness(palette: Tensor) -> Tensor:
    """L_distinct, scalar: mean over all jk of 1 - |P_j - P_k|^2 / the largest such; 1 if all are equal."""
    apart = (palette[:, None] - palette).square().sum(-1)
    return (1 - apart / apart.max().clamp_min(1e-12)).mean()


# -- of a view's picture --------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Neighbors:
    """A view's pairs as tensors. first, second: [m] places of their pixels. edges: [m] zeta over the largest of the
    view's, 0..1. transition: [m] lambda of the second. pixels: n."""

    first: Tensor
    second: Tensor
    edges: Tensor
    transition: Tensor
    pixels: int

    @classmethod
    def of(cls, view: EditView, device: torch.device | str = "cpu") -> "Neighbors":
        upper, lower, left, right = view.pairs()
        first, second = np.concatenate([upper, left]), np.concatenate([lower, right])
        # The code takes zeta itself in L_TV, which has no bound, and zeta over its largest in L_disc.
        edges = [view.edges[some, axis] / max(float(view.edges[:, axis].max()), 1e-12)
                 for axis, some in enumerate((upper, left))]  # fmt: skip
        transition = view.transition[second].astype(np.float32)
        parts = first, second, np.concatenate(edges).astype(np.float32), transition
        return cls(*(torch.from_numpy(part).to(device) for part in parts), len(view))

    def differences(self, colors: Tensor) -> Tensor:
        """Sum over channels of (C_i - C_{i+1})^2 per pair, [m]."""
        # index_select: its gradient is added up in one order, that of indexing is not.
        return (colors.index_select(0, self.first) - colors.index_select(0, self.second)).square().sum(1)


def variation(differences: Tensor, neighbors: Neighbors) -> Tensor:
    """L_TV, scalar: sum over pairs of (C_i - C_{i+1})^2 (1 - zeta) (1 - lambda), over REFERENCE_PIXELS.

    Twice the resolution halves the differences and gives four times as many: the sum, not the mean, stays as it is.
    """
    return (differences * (1 - neighbors.edges) * (1 - neighbors.transition)).sum() / REFERENCE_PIXELS


def edge_contrast(differences: Tensor, neighbors: Neighbors) -> Tensor:
    """L_disc, scalar <= 0: minus the sum over pairs of (C_i - C_{i+1})^2 zeta, over sqrt(n REFERENCE_PIXELS).

    Steps at geometry edges stay as large at any resolution, and twice as many pairs cross an edge at twice it.
    """
    return -(differences * neighbors.edges).sum() / (neighbors.pixels * REFERENCE_PIXELS) ** 0.5


def transition_error(colors: Tensor, target: Tensor, transition: Tensor) -> Tensor:
    """L_smooth per pixel, [n]: lambda times the sum over channels of (C - t)^2."""
    return transition * (colors - target).square().sum(1)


# -- figures --------------------------------------------------------------------------------------------------------


def sparsity(weights: np.ndarray) -> float:
    """L_sp: mean over pixels of (sum w / sum w^2 - 1), weights [n, A]; 0 where one color has all, A - 1 where all have
    the same (supplement, eq. 2). 0 for no pixel."""
    squares = np.square(weights, dtype=np.float64).sum(1)
    return float((weights.sum(1, dtype=np.float64) / squares - 1).mean()) if len(weights) else 0.0


def weight_variation(weights: np.ndarray, view: EditView) -> float:
    """Palette TV of a view: sum over pairs ij of neighbors and over weights [n, A] of ((w_i - w_j) a_i a_j)^2, over n.

    a: alpha of the field. As LAENeRF's released code measures it where an edit is put into the photos.
    """
    upper, lower, left, right = view.pairs()
    first, second = np.concatenate([upper, left]), np.concatenate([lower, right])
    differences = np.square(weights[first].astype(np.float64) - weights[second]).sum(1)
    gates = view.weight[first].astype(np.float64) * view.weight[second]
    return float((differences * gates**2).sum() / max(len(view), 1))
