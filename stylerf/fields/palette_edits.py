"""What a user changes of a learned palette; nothing is trained again (LAENeRF, 3.5 and eq. 4 of its supplement)."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from stylerf import validation
from stylerf.errors import InvalidValue
from stylerf.srgb import LUMA


@dataclass(frozen=True)
class PaletteEdits:
    """Changes of palette colors, by their index.

    colors: new sRGB. scales, biases: w~ = max(s w + b, 0), divided by the row's sum (the supplement prints min, the
    code takes max); a row of zeros falls back to w.
    """

    colors: Mapping[int, tuple[float, ...]] = field(default_factory=dict)
    scales: Mapping[int, float] = field(default_factory=dict)
    biases: Mapping[int, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for named in (self.colors, self.scales, self.biases):
            for index, value in named.items():
                if not np.isfinite(value).all():
                    raise InvalidValue(f"palette color {index}: {value} is not finite")
        for index, color in self.colors.items():
            if len(color) != 3:
                raise InvalidValue(f"palette color {index}: expected red, green and blue, found {color}")

    def __bool__(self) -> bool:
        return bool(self.colors or self.scales or self.biases)

    def check(self, count: int) -> None:
        """Raises InvalidValue, naming the colors that exist, where one of another index is changed."""
        missing = sorted({i for named in (self.colors, self.scales, self.biases) for i in named} - set(range(count)))
        if missing:
            exist = f"0 to {count - 1}" if count > 1 else "0 alone"
            raise InvalidValue(f"palette color {missing[0]} does not exist; there are {exist}")

    def palette(self, palette: np.ndarray) -> np.ndarray:
        """[A, 3] with the changed colors in place."""
        self.check(len(palette))
        out = palette.copy()
        for index, color in self.colors.items():
            out[index] = color
        return out

    def weights(self, weights: np.ndarray) -> np.ndarray:
        """w~ [n, A] of weights [n, A]."""
        count = weights.shape[1]
        self.check(count)
        if not self.scales and not self.biases:
            return weights
        scales, biases = np.ones(count, np.float32), np.zeros(count, np.float32)
        for index, scale in self.scales.items():
            scales[index] = scale
        for index, bias in self.biases.items():
            biases[index] = bias
        changed = np.maximum(scales * weights + biases, 0)
        total = changed.sum(1, keepdims=True)
        return np.where(total > 1e-6, changed / np.maximum(total, 1e-6), weights).astype(np.float32)

    def describe(self) -> dict:
        """As JSON keeps it."""
        return {
            "colors": {str(i): [float(v) for v in color] for i, color in self.colors.items()},
            "scales": {str(i): float(v) for i, v in self.scales.items()},
            "biases": {str(i): float(v) for i, v in self.biases.items()},
        }

    @classmethod
    def restore(cls, data: dict) -> "PaletteEdits":
        colors, *weights = (validation.entry(data, name, dict) for name in ("colors", "scales", "biases"))
        return cls(
            {_index(i): tuple(validation.numbers(colors, i, 3)) for i in colors},
            *({_index(i): validation.number(named, i) for i in named} for named in weights),
        )


def _index(text: str) -> int:
    """A color's number, as JSON has it for a key."""
    if not (text.isascii() and text.isdecimal() and len(text) <= 4):
        raise InvalidValue(f"palette color {text[:20]!r} is no number")
    return int(text)


def tinted(palette: np.ndarray, shares: np.ndarray, target: tuple[float, float, float]) -> np.ndarray:
    """[A, 3]: `target` in the palette's own lights and darks: each color is target times luma / mean luma, in 0..1.

    shares: of the colors in the region, which weigh the mean. All in sRGB; an encoded ratio is a power of that of
    light, so that shading keeps its contrast.
    """
    lumas = palette @ np.asarray(LUMA, palette.dtype)
    mean = float((lumas * shares).sum() / max(float(np.sum(shares)), 1e-9))
    return np.clip(np.asarray(target, palette.dtype) * (lumas / max(mean, 1e-3))[:, None], 0, 1)
