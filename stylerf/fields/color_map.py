"""The affine map of a stylized field's rendered colors (decision 0006)."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from stylerf import validation

if TYPE_CHECKING:  # torch takes more than a second to import, and most fields are rendered without it
    from torch import Tensor


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
