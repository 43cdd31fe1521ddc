"""A colour with local detail that does not depend on the view: a multi-resolution hash grid (Mueller et al. 2022)."""

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.kernels.cpu import hash as kernels


def level_layout(levels: int, base: int, finest: int, table: int, features: int) -> np.ndarray:
    """[levels, 4] int64 as the kernels read it; resolutions grow geometrically from `base` to `finest` cells a side."""
    growth = (finest / base) ** (1 / max(levels - 1, 1))
    layout = np.empty((levels, 4), np.int64)
    at = 0
    for level in range(levels):
        resolution = round(base * growth**level)
        vertices = (resolution + 1) ** 3
        entries = min(vertices, table)
        layout[level] = resolution, at, entries - 1, vertices <= table
        at += entries * features
    return layout


class HashColour:
    """Colour sigmoid(bias + head . features(x)). values: the levels' tables, head [3, levels * features], bias [3].

    levels, base, finest, table, features: see kernels/cpu/hash.py; table: entries of a level, a power of two.
    """

    kind = "hash"
    degree = 0

    def __init__(self, levels: int, base: int, finest: int, table: int, features: int, values: np.ndarray) -> None:
        if levels < 1 or not 1 <= base <= finest or table & (table - 1) or features not in (2, 4, 8):
            raise InvalidValue(
                f"hash colour: {levels} levels of {base}..{finest} cells, {table} entries (a power of two), "
                f"{features} features (2, 4 or 8)"
            )
        self.levels, self.base, self.finest, self.table, self.features = levels, base, finest, table, features
        self.layout = level_layout(levels, base, finest, table, features)
        self.values = values
        self._features, self._width = (np.int8(0),) * features, (np.int8(0),) * (levels * features)
        expected = self.tables_length + 3 * levels * features + 3
        if len(values) != expected:
            raise InvalidValue(f"hash colour: {len(values)} values where {expected} were expected")

    @property
    def tables_length(self) -> int:
        """Floats of all levels' tables."""
        return int(self.layout[-1, 1] + (self.layout[-1, 2] + 1) * self.features)

    @classmethod
    def create(
        cls,
        generator: np.random.Generator,
        levels: int = 8,
        base: int = 16,
        finest: int = 512,
        table: int = 1 << 17,
        features: int = 4,
    ) -> "HashColour":
        """An even grey: tables next to zero, the head random."""
        layout = level_layout(levels, base, finest, table, features)
        length = int(layout[-1, 1] + (layout[-1, 2] + 1) * features)
        width = levels * features
        tables = generator.uniform(-1e-2, 1e-2, length)
        head = generator.uniform(-1, 1, 3 * width) / np.sqrt(features)
        values = np.concatenate([tables, head, np.zeros(3)]).astype(np.float32)
        return cls(levels, base, finest, table, features, values)

    def groups(self) -> list[tuple[int, int, float]]:
        """(begin, end, learning-rate factor) of parts of `values`."""
        return [(0, self.tables_length, 1.0), (self.tables_length, len(self.values), 0.1)]

    def colours(self, x, basis, starts, ends, weights, least, chunks) -> np.ndarray:
        """[n, 3] colours in 0..1 of samples with weight > least; others have -1 in the first channel.

        basis: not used, the colour is the same from everywhere.
        """
        out = np.empty((len(x), 3), np.float32)
        kernels.colour(
            self.values,
            self.layout,
            self._features,
            self._width,
            x,
            starts,
            ends,
            weights,
            np.float32(least),
            chunks,
            out,
        )
        return out

    def backward(self, x, basis, starts, ends, colours, colour_gradients, to: np.ndarray) -> None:
        """Add dL/d(values) to the chunks' buffers `to` [chunks, len(values)]."""
        kernels.colour_backward(
            self.values,
            self.layout,
            self._features,
            self._width,
            x,
            starts,
            ends,
            colours,
            colour_gradients,
            len(to),
            to,
        )

    def colours_at(self, x: np.ndarray, chunks: int) -> np.ndarray:
        """[n, 3] colours of packed warped points [n, 3] float32."""
        starts, ends = _pieces(len(x), chunks)
        return self.colours(x, None, starts, ends, np.ones(len(x), np.float32), 0.0, chunks)

    def backward_at(self, x: np.ndarray, colours: np.ndarray, colour_gradients: np.ndarray, to: np.ndarray) -> None:
        """As backward, for packed points."""
        starts, ends = _pieces(len(x), len(to))
        self.backward(x, None, starts, ends, colours, colour_gradients, to)

    def smooth(self, strength: float, to: np.ndarray) -> None:
        """Add strength/n times the values of the tables to `to`: a pull towards the coarser levels' colour.

        Neighbouring vertices of a hashed level may share their entry with any other place, so differences between
        neighbours mean little; a decay of the fine levels, where detail and noise live, smooths instead.
        """
        n = self.tables_length
        to[:n] += np.float32(strength / n) * self.values[:n]

    def describe(self) -> dict:
        return {
            "kind": self.kind,
            "levels": self.levels,
            "base": self.base,
            "finest": self.finest,
            "table": self.table,
            "features": self.features,
        }

    @classmethod
    def restore(cls, data: dict, values: np.ndarray) -> "HashColour":
        return cls(data["levels"], data["base"], data["finest"], data["table"], data["features"], values)


def _pieces(n: int, chunks: int) -> tuple[np.ndarray, np.ndarray]:
    """n packed samples as `chunks` rays, one to a chunk."""
    edges = np.arange(chunks + 1, dtype=np.int64) * n // chunks
    return edges[:-1].copy(), edges[1:].copy()
