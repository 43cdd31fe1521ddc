"""The affine map of a stylized field's rendered colors (decision 0006)."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from stylerf import validation

if TYPE_CHECKING:  # torch takes more than a second to import, and most fields are rendered without it
    from torch import Tensor

Array = TypeVar("Array", "Tensor", np.ndarray)


@dataclass(frozen=True)
class ColorMap:
    """x' = matrix x + offset on sRGB colors of rendered pixels; matrix [3, 3], offset [3]."""

    matrix: "Tensor"
    offset: "Tensor"

    def __call__(self, colors: "Tensor") -> "Tensor":
        """Colors [..., 3] mapped, not clamped."""
        return colors @ self.matrix.T.to(colors) + self.offset.to(colors)

    def image(self, image: "Tensor") -> "Tensor":
        """The same on an image [3, h, w], clamped to [0, 1]."""
        return self(image.movedim(0, -1)).clamp(0, 1).movedim(-1, 0).contiguous()

    def after(self, first: "ColorMap") -> "ColorMap":
        """The single map that does `first`, then this one."""
        return ColorMap(self.matrix @ first.matrix, self.matrix @ first.offset + self.offset)

    def premultiplied(self, colors: "Tensor", alpha: "Tensor") -> "Tensor":
        """Premultiplied colors [..., 3] of coverage alpha [...]: A (alpha x) + alpha b = alpha (A x + b)."""
        return colors @ self.matrix.T.to(colors) + alpha[..., None] * self.offset.to(colors)

    def arrays(self) -> tuple[np.ndarray, np.ndarray]:
        """Matrix and offset, float32."""
        return self.matrix.numpy().astype(np.float32), self.offset.numpy().astype(np.float32)

    def describe(self) -> dict:
        return {"matrix": self.matrix.tolist(), "offset": self.offset.tolist()}

    @classmethod
    def restore(cls, data: dict | None) -> "ColorMap | None":
        """Rebuild a map of describe(); None of None. InvalidValue: the data do not make one."""
        if data is None:
            return None
        import torch

        matrix, offset = validation.rows(data, "matrix", 3, 3), validation.numbers(data, "offset", 3)
        return cls(torch.tensor(matrix), torch.tensor(offset))


def before_map(gradients: Array, matrix: Array, offset: Array) -> None:
    """Replace dL/d(pixels after a color map) by dL/d(pixels before it), in place; clamps are not differentiated.

    Args:
        gradients: [n, 4 or more], of premultiplied rgb, alpha and what a map does not change.
        matrix, offset: [3, 3] and [3] of the map, rgb' = A rgb + alpha b, as `gradients` on their device.
    """
    # dL/d(alpha) += dL/drgb' . b and dL/drgb = A^T dL/drgb'; alpha first, before rgb is overwritten.
    gradients[:, 3] += gradients[:, :3] @ offset
    gradients[:, :3] = gradients[:, :3] @ matrix
