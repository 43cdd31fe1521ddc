"""A palette module on a GPU: the hash table uses our kernels, the networks use torch."""

import numpy as np
import torch
from torch import Tensor

from stylerf.editing.palette_module import DEGREE, POINTS_AT_ONCE, Mixture, PaletteEvaluator, PaletteModule
from stylerf.fields.palette_edits import PaletteEdits
from stylerf.geometry.spherical_harmonics import harmonics
from stylerf.kernels.gpu import launch


class GpuPaletteModule(PaletteEvaluator):
    """A copy of a module on `device`; results equal PaletteModule's up to rounding. Edits apply on the host.

    Attributes:
        module: The original.
        table, networks: Trainable copies of the encoding's values and of the module's.
    """

    def __init__(self, module: PaletteModule, device: torch.device | str) -> None:
        self.module, self.device, self.levels = module, torch.device(device), module.encoding.levels
        self.layout = torch.from_numpy(module.encoding.layout).to(self.device)
        self._low, self._size = (
            torch.from_numpy(a).to(self.device) for a in (module.box[0].copy(), module.box[1] - module.box[0])
        )
        self._known: tuple[bytes, Tensor] = b"", torch.empty(0)
        self.take_up()

    def take_up(self) -> None:
        """Copy the module's values to the device."""
        self.table = torch.from_numpy(self.module.encoding.values).to(self.device, copy=True)
        self.networks = torch.from_numpy(self.module.values).to(self.device, copy=True)

    def collect(self) -> None:
        """Copy the trained values back to the module."""
        self.module.encoding.values[:] = self.table.cpu().numpy()
        self.module.values[:] = self.networks.cpu().numpy()

    @property
    def kept(self) -> Tensor:
        """Indices of the active colors."""
        active = self.module.active.tobytes()  # requested in every step, but changes only at the pruning
        if self._known[0] != active:
            self._known = active, torch.from_numpy(np.flatnonzero(self.module.active)).to(self.device)
        return self._known[1]

    def local(self, x: Tensor) -> Tensor:
        """Return cube points [n, 3] relative to the box, 0..1."""
        return ((x - self._low) / self._size).clamp(0, 1)

    def features(self, x: Tensor, to: Tensor) -> Tensor:
        """Encode points of the box [n, 3] to [n, 4 levels], differentiably; backward adds dL/d(table) to `to`."""
        # The dummy scalar makes autograd call backward although the table is not a leaf of the graph.
        phi: Tensor = _Encode.apply(torch.zeros((), requires_grad=True, device=self.device), self, x.contiguous(), to)
        return phi

    # -- evaluation --------------------------------------------------------------------------------------------------

    @property
    def active(self) -> np.ndarray:
        return self.module.active

    @property
    def palette(self) -> np.ndarray:
        return self.networks[: 3 * len(self.active)].view(-1, 3)[self.kept].clamp(0, 1).cpu().numpy()

    @torch.no_grad()
    def mixture(self, x: np.ndarray, directions: np.ndarray, threads: int = 1) -> Mixture:
        parts = []
        for at in range(0, max(1, len(x)), POINTS_AT_ONCE):
            part = slice(at, at + POINTS_AT_ONCE)
            points = torch.from_numpy(np.ascontiguousarray(x[part], np.float32)).to(self.device)
            basis = torch.from_numpy(harmonics(directions[part], DEGREE)).to(self.device)
            phi = launch.rows(self.table, self.layout, self.levels, self.local(points))
            parts.append(self.module.mix(self.networks, phi, basis, self.kept))
        return Mixture(*(torch.cat([getattr(p, n) for p in parts]).cpu() for n in ("weights", "offsets", "colors")))

    def edited(
        self, found: Mixture, edits: PaletteEdits | None = None, transition: np.ndarray | None = None
    ) -> np.ndarray:
        return self.module.edited(found, edits, transition)


class _Encode(torch.autograd.Function):
    """Adds the table's gradient to the optimizer's buffer; see fields/hash_encoding.py."""

    @staticmethod
    def forward(context, hook: Tensor, palette: GpuPaletteModule, x: Tensor, to: Tensor) -> Tensor:
        context.palette, context.x, context.to = palette, x, to
        return launch.rows(palette.table, palette.layout, palette.levels, x)

    @staticmethod
    def backward(context, gradients: Tensor) -> tuple[None, None, None, None]:
        palette = context.palette
        launch.rows_backward(palette.layout, palette.levels, context.x, gradients.contiguous(), context.to)
        return None, None, None, None
