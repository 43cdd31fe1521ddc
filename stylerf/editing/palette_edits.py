"""What a user changes of a learnt palette; nothing is trained again (LAENeRF, 3.5 and eq. 4 of its supplement)."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from stylerf import validation
from stylerf.errors import InvalidValue
from stylerf.srgb import LUMA


@dataclass(frozen=True)
class PaletteEdits:
    """Changes of palette colours, by their index.

    colours: new sRGB. scales, biases: w~ = max(s w + b, 0), divided by the row's sum (the supplement prints min, the
    code takes max); a row of zeros falls back to w.
    """

    colours: Mapping[int, tuple[float, float, float]] = field(default_factory=dict)
    scales: Mapping[int, float] = field(default_factory=dict)
    biases: Mapping[int, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for named in (self.colours, self.scales, self.biases):
            for index, value in named.items():
                if not np.isfinite(value).all():
                    raise InvalidValue(f"palette colour {index}: {value} is not finite")
        for index, colour in self.colours.items():
            if len(colour) != 3:
                raise InvalidValue(f"palette colour {index}: expected red, green and blue, found {colour}")

    def __bool__(self) -> bool:
        return bool(self.colours or self.scales or self.biases)

    def check(self, count: int) -> None:
        """Raises InvalidValue, naming the colours that exist, where one of another index is changed."""
        missing = sorted({i for named in (self.colours, self.scales, self.biases) for i in named} - set(range(count)))
        if missing:
            exist = f"0 to {count - 1}" if count > 1 else "0 alone"
            raise InvalidValue(f"palette colour {missing[0]} does not exist; there are {exist}")

    def palette(self, palette: np.ndarray) -> np.ndarray:
        """[A, 3] with the changed colours in place."""
        self.check(len(palette))
        out = palette.copy()
        for index, colour in self.colours.items():
            out[index] = colour
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
            "colours": {str(i): [float(v) for v in colour] for i, colour in self.colours.items()},
            "scales": {str(i): float(v) for i, v in self.scales.items()},
            "biases": {str(i): float(v) for i, v in self.biases.items()},
        }

    @classmethod
    def restore(cls, data: dict) -> "PaletteEdits":
        colours, *weights = (validation.entry(data, name, dict) for name in ("colours", "scales", "biases"))
        return cls(
            {_index(i): tuple(validation.numbers(colours, i, 3)) for i in colours},
            *({_index(i): validation.number(named, i) for i in named} for named in weights),
        )


def _index(text: str) -> int:
    """A colour's number, as JSON has it for a key."""
    if not (text.isascii() and text.isdecimal() and len(text) <= 4):
        raise InvalidValue(f"palette colour {text[:20]!r} is no number")
    return int(text)


def tinted(palette: np.ndarray, shares: np.ndarray, target: tuple[float, float, float]) -> np.ndarray:
    """[A, 3]: `target` in the palette's own lights and darks: each colour is target times luma / mean luma, in 0..1.

    shares: of the colours in the region, which weigh the mean. All in sRGB; an encoded ratio is a power of that of
    light, so that shading keeps its contrast.
    """
    lumas = palette @ np.asarray(LUMA, palette.dtype)
    mean = float((lumas * shares).sum() / max(float(np.sum(shares)), 1e-9))
    return np.clip(np.asarray(target, palette.dtype) * (lumas / max(mean, 1e-3))[:, None], 0, 1)
