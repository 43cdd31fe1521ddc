"""A colour part whose colours are moved by an affine map: exact colour matching at the end of a stylisation."""

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.fields.hash import HashColour
from stylerf.fields.vm import VmColour

INNER_KINDS = {"vm": VmColour, "hash": HashColour}


class MatchedColour:
    """Colour clamp(matrix c + offset, 0, 1) of another part's colour c. For rendering: the inner part learns.

    matrix [3, 3], offset [3]: sRGB-encoded rgb to rgb.
    """

    kind = "matched"

    def __init__(self, inner, matrix: np.ndarray, offset: np.ndarray) -> None:
        self.inner = inner
        self.matrix, self.offset = np.asarray(matrix, np.float32), np.asarray(offset, np.float32)
        if self.matrix.shape != (3, 3) or self.offset.shape != (3,) or inner.kind not in INNER_KINDS:
            raise InvalidValue(
                f"matched colour: matrix {self.matrix.shape}, offset {self.offset.shape} over a part of kind "
                f"{inner.kind!r}; expected (3, 3), (3,) over one of {', '.join(INNER_KINDS)}"
            )
        if not (np.isfinite(self.matrix).all() and np.isfinite(self.offset).all()):
            raise InvalidValue("matched colour: matrix or offset is not finite")

    @property
    def degree(self) -> int:
        """Degree of the spherical harmonics that the inner part takes."""
        return self.inner.degree

    @property
    def values(self) -> np.ndarray:
        """The inner part's values."""
        return self.inner.values

    def groups(self) -> list[tuple[int, int, float]]:
        return self.inner.groups()

    def _matched(self, colours: np.ndarray) -> np.ndarray:
        out = np.clip(colours @ self.matrix.T + self.offset, 0, 1)
        out[colours[:, 0] < 0, 0] = -1
        return out

    def colours(self, x, basis, starts, ends, weights, least, chunks) -> np.ndarray:
        """As the inner part's, mapped; samples without a colour keep their -1."""
        return self._matched(self.inner.colours(x, basis, starts, ends, weights, least, chunks))

    def colours_at(self, x: np.ndarray, chunks: int) -> np.ndarray:
        """As the inner part's, mapped (a part that depends on the view has none)."""
        return self._matched(self.inner.colours_at(x, chunks))

    def backward(self, x, basis, starts, ends, colours, colour_gradients, to: np.ndarray) -> None:
        """Always InvalidValue: where the clamp holds, the mapped colours do not tell the inner ones."""
        raise InvalidValue("a matched colour has no gradient; train its inner part and match the result")

    def describe(self) -> dict:
        return {
            "kind": self.kind,
            "matrix": self.matrix.tolist(),
            "offset": self.offset.tolist(),
            "inner": self.inner.describe(),
        }

    @classmethod
    def restore(cls, data: dict, values: np.ndarray) -> "MatchedColour":
        inner = INNER_KINDS[data["inner"]["kind"]].restore(data["inner"], values)
        return cls(inner, data["matrix"], data["offset"])
