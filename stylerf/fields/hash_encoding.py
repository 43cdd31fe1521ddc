"""Multi-resolution hash encoding with concatenated levels."""

import numpy as np
import torch
from torch import Tensor

from stylerf.errors import InvalidValue
from stylerf.fields.hash_grid import HashFeatures, Levels, grid_of
from stylerf.kernels.cpu.simd_hash import ROW


class HashEncoding:
    """phi(x) [n, 4 levels]: for each level, the four floats per vertex around x, interpolated.

    The levels have `base` to `finest` cells per side; table: maximum number of vertices stored per level, a power of
    two. values: the levels' tables, concatenated, float32. Eight levels give LAENeRF's 32 features (16 levels of two).
    """

    kind = "hash-encoding"

    def __init__(self, levels: int, base: int, finest: int, table: int, values: np.ndarray) -> None:
        self.features = HashFeatures(Levels(int(levels), int(base), int(finest), int(table), ROW, int(levels)))
        expected = self.features.length
        if values.shape != (expected,) or values.dtype != np.float32:
            raise InvalidValue(f"hash encoding: {expected} float32 values expected, found {values.dtype}{values.shape}")
        self.levels, self.base, self.finest, self.table = int(levels), int(base), int(finest), int(table)
        self.values, self.layout, self.width = values, self.features.layout, self.features.width

    @classmethod
    def create(
        cls,
        generator: np.random.Generator,
        levels: int = 8,
        base: int = 16,
        finest: int = 256,
        table: int = 1 << 16,
        spread: float = 1e-2,
    ) -> "HashEncoding":
        """Create features uniform in +-spread; from the 1e-4 of Mueller et al., growing takes hundreds of steps."""
        count = Levels(levels, base, finest, table, ROW, levels).length
        return cls(levels, base, finest, table, generator.uniform(-spread, spread, count).astype(np.float32))

    def forward(self, x: np.ndarray, threads: int) -> Tensor:
        """Return phi [n, 4 levels] for cube points x [n, 3] float32 in 0..1, without autograd."""
        x, out = np.ascontiguousarray(x, np.float32), torch.empty(len(x), self.width)
        # In memory allocated by torch: alignment can change the last bit of the matrix product that follows.
        self.features.encode(self.values, x, np.arange(len(x)), threads, out.numpy())
        return out

    def backward(self, x: np.ndarray, gradients: np.ndarray, to: np.ndarray) -> None:
        """Add dL/d(values) to the per-thread buffers `to` [threads, len(values)], from dL/d(phi) [n, 4 levels]."""
        x, gradients = (np.ascontiguousarray(array, np.float32) for array in (x, gradients))
        self.features.backward(self.values, x, np.arange(len(x)), gradients, to)

    def __call__(self, x: np.ndarray, to: np.ndarray) -> Tensor:
        """Return phi with autograd; its backward adds dL/d(values) to the buffers `to` [threads, len(values)].

        Not differentiable with respect to x.
        """
        # Autograd calls backward only if some input requires a gradient, hence the dummy scalar.
        return _Encode.apply(torch.zeros((), requires_grad=True), self, x, to)

    def describe(self) -> dict:
        return {"kind": self.kind, **self.features.levels.describe(growing=False)}

    @classmethod
    def restore(cls, data: dict, values: np.ndarray) -> "HashEncoding":
        return cls(*grid_of(data), values)


class _Encode(torch.autograd.Function):
    """Adds the table's gradient directly to the sparse optimizer's buffers. A dense gradient tensor would be summed,
    copied and cleared in every step, although a batch touches only a hundredth of it.
    """

    @staticmethod
    def forward(context, hook: Tensor, encoding: HashEncoding, x: np.ndarray, to: np.ndarray) -> Tensor:
        context.encoding, context.x, context.to = encoding, x, to
        return encoding.forward(x, len(to))

    @staticmethod
    def backward(context, gradients: Tensor) -> tuple[None, None, None, None]:
        context.encoding.backward(context.x, gradients.contiguous().numpy(), context.to)
        return None, None, None, None
