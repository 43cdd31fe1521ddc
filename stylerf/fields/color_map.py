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
    """x' = matrix x + offset for sRGB colors of rendered pixels; matrix [3, 3], offset [3]."""

    matrix: "Tensor"
    offset: "Tensor"

    def __call__(self, colors: "Tensor") -> "Tensor":
        """Map colors [..., 3], without clamping."""
        return colors @ self.matrix.T.to(colors) + self.offset.to(colors)

    def image(self, image: "Tensor") -> "Tensor":
        """Map an image [3, h, w], clamped to [0, 1]."""
        return self(image.movedim(0, -1)).clamp(0, 1).movedim(-1, 0).contiguous()

    def after(self, first: "ColorMap") -> "ColorMap":
        """Return the composition of `first`, then this map."""
        return ColorMap(self.matrix @ first.matrix, self.matrix @ first.offset + self.offset)

    def premultiplied(self, colors: "Tensor", alpha: "Tensor") -> "Tensor":
        """Map premultiplied colors [..., 3] with coverage alpha [...]: A (alpha x) + alpha b = alpha (A x + b)."""
        return colors @ self.matrix.T.to(colors) + alpha[..., None] * self.offset.to(colors)

    def arrays(self) -> tuple[np.ndarray, np.ndarray]:
        """Return (matrix, offset), float32."""
        return self.matrix.numpy().astype(np.float32), self.offset.numpy().astype(np.float32)

    def describe(self) -> dict:
        return {"matrix": self.matrix.tolist(), "offset": self.offset.tolist()}

    @classmethod
    def restore(cls, data: dict | None) -> "ColorMap | None":
        """Rebuild a map from describe(), or None from None. Raises InvalidValue if the data are not a valid map."""
        if data is None:
            return None
        import torch

        matrix, offset = validation.rows(data, "matrix", 3, 3), validation.numbers(data, "offset", 3)
        return cls(torch.tensor(matrix), torch.tensor(offset))


def before_map(gradients: Array, matrix: Array, offset: Array) -> None:
    """Replace dL/d(pixels after a color map) by dL/d(pixels before it), in place; clamps are not differentiated.

    Args:
        gradients: [n, 4 or more]: premultiplied rgb, alpha, then channels that the map does not change.
        matrix, offset: the map rgb' = A rgb + alpha b, [3, 3] and [3], on the same device as `gradients`.
    """
    # dL/d(alpha) += dL/drgb' . b and dL/drgb = A^T dL/drgb'; alpha first, before rgb is overwritten.
    gradients[:, 3] += gradients[:, :3] @ offset
    gradients[:, :3] = gradients[:, :3] @ matrix
