"""The engine of a local edit on a GPU: views, table, networks and moments stay there; no step synchronizes."""

import numpy as np
import torch
from torch import Tensor

from stylerf.editing.extraction import EditView
from stylerf.editing.palette_module import DEGREE, PaletteModule
from stylerf.editing.palette_module_gpu import GpuPaletteModule
from stylerf.fields.gpu.memory import free_on
from stylerf.geometry.spherical_harmonics import harmonics
from stylerf.training.common.adam import moments_of, restore_moments
from stylerf.training.common.adam_gpu import GpuAdam
from stylerf.training.common.async_readback import AsyncReadback, sent
from stylerf.training.common.bounded_cache import BoundedCache
from stylerf.training.edit.engine import groups_of

MEMORY = 8e9  # most bytes of views on the device, or a third of its free memory; other views are sent every time
MOST_PARTS = 16  # per loss


class GpuEditEngine:
    """CpuEditEngine on `device`, with equal results up to rounding; `threads` is unused."""

    def __init__(
        self,
        views: list[EditView],
        module: PaletteModule,
        threads: int,
        *,
        device: torch.device | str,
        memory: float | None = None,
    ) -> None:
        self.device, self.views = torch.device(device), views
        self.evaluator = GpuPaletteModule(module, self.device)
        memory = min(MEMORY, free_on(self.device, 3 * MEMORY) / 3) if memory is None else memory
        self._there = BoundedCache(self._moved, lambda parts: sum(part.nbytes for part in parts), len(views), memory)
        nothing: dict[str, float] = {}
        self._reports = AsyncReadback(self.device, MOST_PARTS, _named, nothing)
        self._new_adams()

    def _new_adams(self) -> None:
        self.table = GpuAdam(self.evaluator.table, [(0, len(self.evaluator.table), 1.0)])
        self.networks = GpuAdam(self.evaluator.networks, groups_of(self.evaluator.module))

    @property
    def kept(self) -> Tensor:
        return self.evaluator.kept

    def _moved(self, at: int) -> tuple[Tensor, ...]:
        view = self.views[at]
        basis = harmonics(view.directions, DEGREE)
        return tuple(sent(array, self.device) for array in (view.x, view.along, basis, view.target))

    def pixels(self, at: int, rows: np.ndarray, jitter: np.ndarray) -> tuple[Tensor, Tensor, Tensor]:
        x, along, basis, target = self._there[at]
        chosen, moved = sent(rows, self.device), sent(jitter, self.device)
        local = self.evaluator.local(x[chosen] + along[chosen] * moved)
        return self.evaluator.features(local, self.table.gradients), basis[chosen], target[chosen]

    def leaf(self) -> Tensor:
        return self.evaluator.networks.detach().clone().requires_grad_()

    def step(self, gradient: Tensor, rate: float, table_rate: float) -> None:
        self.networks.gradients += gradient
        self.networks.step(rate)
        self.table.step(table_rate)

    def report(self, parts: dict[str, Tensor]) -> dict[str, float]:
        values = self._reports.begin()
        values[: len(parts)] = torch.stack([part.detach() for part in parts.values()])
        return self._reports.send(tuple(parts))

    def settle(self) -> dict[str, float]:
        return self._reports.settle()

    def collect(self) -> None:
        self.evaluator.collect()

    def moments(self) -> dict[str, np.ndarray]:
        return moments_of({"table": self.table, "networks": self.networks})

    def resume(self, moments: dict[str, np.ndarray]) -> None:
        self.evaluator.take_up()
        self._new_adams()
        restore_moments({"table": self.table, "networks": self.networks}, moments)


def _named(values: list[float], names: tuple[str, ...]) -> dict[str, float]:
    return dict(zip(names, values))
