"""What learning an edit asks of whatever holds its palette module: features of a view's pixels, and optimizers.

The loop (stylerf/training/edit/trainer.py) decides which pixels and what their loss is; an engine holds the numbers, on
the CPU (here) or on a GPU (stylerf/training/edit/engine_gpu.py). Losses are torch's, wherever their tensors lie.
"""

from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor

from stylerf.editing.edit_views import EditView
from stylerf.editing.palette_module import DEGREE, PaletteModule
from stylerf.geometry.spherical_harmonics import harmonics
from stylerf.training.common.adam import Adam


class EditEngine(Protocol):
    """device: where tensors lie. kept: numbers of the active colors there, or None. asked: answers as the module does
    as it now stands."""

    device: torch.device
    kept: Tensor | None
    asked: Any

    def shown(self, at: int, rows: np.ndarray, jitter: np.ndarray) -> tuple[Tensor, Tensor, Tensor]:
        """Of pixels `rows` [n] of view number `at`, ends moved by jitter [n, 1]: features in a graph whose backward
        adds to the table's gradients, harmonics of their directions [n, 9], colors of the photo [n, 3]."""

    def leaf(self) -> Tensor:
        """A copy of the module's `values` that gradients are asked of."""

    def step(self, values: Tensor, rate: float, table_rate: float) -> None:
        """Both optimizers, from the gradient of `values` and what shown() has had added."""

    def tell(self, parts: dict[str, Tensor]) -> dict[str, float]:
        """Parts of a loss as numbers. A GPU's are those of the newest step that it has finished; none at first."""

    def settle(self) -> dict[str, float]:
        """Those of the last step, waiting for it where need be."""

    def collect(self) -> None:
        """Bring what was learned into the module's own arrays."""

    def moments(self) -> dict[str, np.ndarray]:
        """What the optimizers remember, by name."""

    def resume(self, moments: dict[str, np.ndarray]) -> None:
        """Go on from the module's arrays as somebody has set them, and from moments()."""


def groups_of(module: PaletteModule) -> list[tuple[int, int, float]]:
    """(begin, end, learning-rate factor) of the module's `values`: the palette learns twice as fast."""
    palette = 3 * len(module.active)
    return [(0, palette, 2.0), (palette, len(module.values), 1.0)]


class CpuEditEngine:
    """numba kernels on `chunks` threads; the same seed gives the same bits."""

    device, kept = torch.device("cpu"), None

    def __init__(self, views: list[EditView], module: PaletteModule, chunks: int) -> None:
        self.views, self.asked = views, module
        table = module.encoding.values
        self.table = Adam(table, [(0, len(table), 1.0)], chunks)
        self.networks = Adam(module.values, groups_of(module), 1)
        self._last: dict[str, float] = {}

    def shown(self, at: int, rows: np.ndarray, jitter: np.ndarray) -> tuple[Tensor, Tensor, Tensor]:
        view = self.views[at]
        x = self.asked.local(view.x[rows] + view.along[rows] * jitter)
        basis = torch.from_numpy(harmonics(view.directions[rows], DEGREE))
        return self.asked.encoding(x, self.table.gradients), basis, torch.from_numpy(view.target[rows])

    def leaf(self) -> Tensor:
        return self.asked.leaf()

    def step(self, values: Tensor, rate: float, table_rate: float) -> None:
        self.networks.gradients[0] += values.grad.numpy()
        self.networks.step(rate)
        self.table.step(table_rate)

    def tell(self, parts: dict[str, Tensor]) -> dict[str, float]:
        self._last = {name: float(part.detach()) for name, part in parts.items()}
        return self._last

    def settle(self) -> dict[str, float]:
        return self._last

    def collect(self) -> None: ...

    def moments(self) -> dict[str, np.ndarray]:
        both = ("table", self.table), ("networks", self.networks)
        return {f"{name}.{k}": v.copy() for name, adam in both for k, v in adam.arrays().items()}

    def resume(self, moments: dict[str, np.ndarray]) -> None:
        for name, adam in (("table", self.table), ("networks", self.networks)):
            adam.restore({k: moments[f"{name}.{k}"] for k in ("first", "second", "steps")})
