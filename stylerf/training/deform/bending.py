"""Regularization of deformations: continuous displacements, and slopes that cannot fold space."""

import numpy as np
import torch
from torch import Tensor

NEIGHBORS = 8
CLOSE = 3  # cells; farther from anything seen, a displacement of FARTHEST has no visible effect


class Extension:
    """Extends the displacements of some vertices of a grid to all of them.

    Any other vertex moves by the mean of its NEIGHBORS nearest given ones, with inverse squared distance weights
    (Shepard 1968). Copying just the nearest one would be discontinuous where two are equally near: on one side of a
    jump things would appear twice, on the other not at all.

    Args:
        active: Ascending flat indices of the given vertices.
        vertices: Number per side.

    Attributes:
        close: [vertices]^3 bool, vertices within CLOSE cells of an active one.
    """

    def __init__(self, active: np.ndarray, vertices: int, device: torch.device) -> None:
        from scipy.spatial import cKDTree

        places = np.stack(np.unravel_index(np.arange(vertices**3), (vertices,) * 3), -1)
        count = min(NEIGHBORS, len(active))
        distances, nearest = cKDTree(places[active]).query(places, k=range(1, count + 1))
        weights = 1 / np.maximum(distances, 1e-4) ** 2  # for an active vertex: itself, to one part in 10^8
        weights /= weights.sum(1, keepdims=True)
        self._nearest = torch.from_numpy(nearest).to(device)
        self._weights = torch.from_numpy(weights.astype(np.float32)).to(device)
        self._active = len(active)
        self.close = torch.from_numpy((distances[:, 0] <= CLOSE).reshape((vertices,) * 3)).to(device)

    def spread(self, moved: Tensor) -> Tensor:
        """Return the displacements of all vertices [vertices^3, 3] from those of the active ones [n, 3]."""
        return (moved[self._nearest] * self._weights[..., None]).sum(1)

    def gathered(self, gradients: Tensor) -> Tensor:
        """Return dL/d(active) [n, 3] from dL/d(all) [vertices^3, 3]: the transpose of spread()."""
        found = gradients.new_zeros((self._active, 3))
        for nearest, weight in zip(self._nearest.T, self._weights.T):
            found.index_add_(0, nearest, gradients * weight[:, None])
        return found


def folding(grid: Tensor, close: Tensor, max_slope: float) -> Tensor:
    """Return the root mean square excess of the displacements' slopes along the axes over `max_slope`.

    x + D(x) cannot fold as long as D changes by less than x does (slope 1); where it folds, a surface appears twice.
    Because of the root, few small excesses pull back as hard as many: it acts as a limit, not as a preference.

    Args:
        grid: [m, m, m, 3], displacements, cube units.
        close: [m, m, m] bool; only pairs of these vertices count.
        max_slope: Displacement per distance, 0..1.
    """
    m, total = len(grid), grid.new_zeros(())
    for axis in range(3):
        both = close.narrow(axis, 1, m - 1) & close.narrow(axis, 0, m - 1)
        # 1e-12 here and 1e-8 below: a square root is not differentiable at 0.
        slope = (grid.diff(dim=axis).square().sum(-1) + 1e-12).sqrt() * (m - 1)
        total = total + ((slope - max_slope).clamp(min=0).square() * both).sum() / both.sum().clamp(min=1)
    return (total + 1e-8).sqrt()
