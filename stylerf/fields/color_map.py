"""Affine maps of sRGB colors, which a field may carry and apply to its rendered pixels."""

from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True)
class ColorMap:
    """x' = matrix x + offset on sRGB colors; matrix [3, 3], offset [3]."""

    matrix: Tensor
    offset: Tensor

    def __call__(self, colors: Tensor) -> Tensor:
        """Colors [..., 3] mapped, not clamped."""
        return colors @ self.matrix.T.to(colors) + self.offset.to(colors)

    def image(self, image: Tensor) -> Tensor:
        """The same on an image [3, h, w], clamped to [0, 1]."""
        return self(image.movedim(0, -1)).clamp(0, 1).movedim(-1, 0).contiguous()

    def after(self, first: "ColorMap") -> "ColorMap":
        """The single map that does `first`, then this one."""
        return ColorMap(self.matrix @ first.matrix, self.matrix @ first.offset + self.offset)

    def premultiplied(self, colors: Tensor, alpha: Tensor) -> Tensor:
        """Premultiplied colors [..., 3] of coverage alpha [...]: A (alpha x) + alpha b = alpha (A x + b)."""
        return colors @ self.matrix.T.to(colors) + alpha[..., None] * self.offset.to(colors)
