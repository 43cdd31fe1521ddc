"""The engine of a local edit on the CPU (engine_gpu.py: on a GPU).

The loop in trainer.py selects pixels and computes losses with torch; an engine holds the module and takes the step.
"""

import numpy as np
import torch
from torch import Tensor

from stylerf.editing.extraction import EditView
from stylerf.editing.palette_module import DEGREE, PaletteModule
from stylerf.geometry.spherical_harmonics import harmonics
from stylerf.training.common.adam import Adam, moments_of, restore_moments


def groups_of(module: PaletteModule) -> list[tuple[int, int, float]]:
    """Return (begin, end, learning-rate factor) for the module's `values`: the palette learns twice as fast."""
    palette = 3 * len(module.active)
    return [(0, palette, 2.0), (palette, len(module.values), 1.0)]


class CpuEditEngine:
    """Numba kernels on `threads` threads; bit-identical for the same seed.

    Attributes:
        device: Of the tensors.
        kept: Indices of the active colors, on that device, or None.
        evaluator: Evaluates the current module.
    """

    device = torch.device("cpu")
    kept: Tensor | None = None

    def __init__(self, views: list[EditView], module: PaletteModule, threads: int) -> None:
        self.views, self.evaluator = views, module
        table = module.encoding.values
        self.table = Adam(table, [(0, len(table), 1.0)], threads)
        self.networks = Adam(module.values, groups_of(module), 1)
        self._last: dict[str, float] = {}

    def pixels(self, at: int, rows: np.ndarray, jitter: np.ndarray) -> tuple[Tensor, Tensor, Tensor]:
        """Return features, spherical harmonics [n, 9] and photo colors [n, 3] of pixels `rows` [n] in view `at`.

        Ray ends are offset by jitter [n, 1]. The features' backward adds to the table's gradients.
        """
        view = self.views[at]
        x = self.evaluator.local(view.x[rows] + view.along[rows] * jitter)
        basis = torch.from_numpy(harmonics(view.directions[rows], DEGREE))
        return self.evaluator.encoding(x, self.table.gradients), basis, torch.from_numpy(view.target[rows])

    def leaf(self) -> Tensor:
        """Return a copy of the module's `values` that requires gradients."""
        return self.evaluator.leaf()

    def step(self, gradient: Tensor, rate: float, table_rate: float) -> None:
        """Step both optimizers with the gradients of the leaf and of the table."""
        # The table's gradient is already in place: the backward of pixels() added it.
        self.networks.gradients[0] += gradient.numpy()
        self.networks.step(rate)
        self.table.step(table_rate)

    def report(self, parts: dict[str, Tensor]) -> dict[str, float]:
        """Return a loss's parts as numbers; on a GPU, those of the newest finished step (none at first)."""
        self._last = {name: float(part.detach()) for name, part in parts.items()}
        return self._last

    def settle(self) -> dict[str, float]:
        """Wait for the last step; return the parts of its loss."""
        return self._last

    def collect(self) -> None:
        """Copy learned values to the module's own arrays, if they are elsewhere."""

    def moments(self) -> dict[str, np.ndarray]:
        """Return the optimizers' moments, by name; the next step may overwrite them."""
        return moments_of({"table": self.table, "networks": self.networks})

    def resume(self, moments: dict[str, np.ndarray]) -> None:
        """Resume from the module's current arrays and moments()."""
        restore_moments({"table": self.table, "networks": self.networks}, moments)
