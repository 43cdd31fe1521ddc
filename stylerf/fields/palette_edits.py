"""User edits of a learned palette, applied without retraining.

PaletteEdits change colors and weights by index (LAENeRF, section 3.5 and eq. 4 of its supplement). A Recoloring applies
them to a decomposed field, everywhere or around given points (PaletteNeRF, Kuang et al. 2023). A basis color
I (P_i + delta_i) varies in space; when a palette color P_i changes, the basis color's hue is rotated and its saturation
and value are scaled by the same amounts, which preserves shading and texture.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from stylerf import validation
from stylerf.errors import InvalidValue
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.srgb import LUMA

if TYPE_CHECKING:  # torch takes more than a second to import, and fields without a palette are rendered without it
    from torch import Tensor

GRAYISH = 0.1  # saturation below which a palette color counts as gray: no hue to rotate, no saturation to scale
MOST_CENTERS = 256  # per filter; every point's distance to each is computed
DARKEST = 1 / 32  # lower bound of a palette color's value when values are scaled


@dataclass(frozen=True)
class PaletteEdits:
    """Changes of palette colors, by index.

    colors: new colors, sRGB. scales, biases: w~ = max(s w + b, 0), divided by the row's sum (the supplement prints min,
    its code uses max); a row of zeros falls back to w.
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
        """Raise InvalidValue, listing the existing colors, if a changed index is not below `count`."""
        missing = sorted({i for named in (self.colors, self.scales, self.biases) for i in named} - set(range(count)))
        if missing:
            exist = f"0 to {count - 1}" if count > 1 else "0 alone"
            raise InvalidValue(f"palette color {missing[0]} does not exist; there are {exist}")

    def palette(self, palette: np.ndarray) -> np.ndarray:
        """Return the palette [A, 3] with the changed colors replaced."""
        self.check(len(palette))
        out = palette.copy()
        for index, color in self.colors.items():
            out[index] = color
        return out

    def weights(self, weights: np.ndarray) -> np.ndarray:
        """Return the changed weights w~ [n, A] of weights [n, A]."""
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
    """Parse a color's index from a JSON key."""
    if not (text.isascii() and text.isdecimal() and len(text) <= 4):
        raise InvalidValue(f"palette color {text[:20]!r} is not a number")
    return int(text)


def tinted(palette: np.ndarray, shares: np.ndarray, target: tuple[float, float, float]) -> np.ndarray:
    """Return `target` at each palette color's relative brightness: target * luma / mean luma, clamped to 0..1, [A, 3].

    shares: the colors' shares of the region, which weight the mean. Everything is in sRGB, where ratios are a power of
    the linear ratios, so shading keeps its contrast.
    """
    lumas = palette @ np.asarray(LUMA, palette.dtype)
    mean = float((lumas * shares).sum() / max(float(np.sum(shares)), 1e-9))
    return np.clip(np.asarray(target, palette.dtype) * (lumas / max(mean, 1e-3))[:, None], 0, 1)


@dataclass(frozen=True)
class SpaceFilter:
    """exp(-|p - c|^2 / reach^2) at points p, in scene units; c: the nearest of the centers."""

    space: SpaceWarp
    centers: tuple[tuple[float, ...], ...]  # x, y, z each
    reach: float

    def __post_init__(self) -> None:
        if not self.centers or not np.isfinite(self.centers).all() or not (0 < self.reach < np.inf):
            raise InvalidValue(f"an edit's filter needs points and a reach above 0, found {self.centers}, {self.reach}")

        if len(self.centers) > MOST_CENTERS:
            raise InvalidValue(
                f"an edit is around {len(self.centers)} points; at most {MOST_CENTERS} are supported. Give fewer, or a "
                "longer reach"
            )

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Return the filter [n], float32 in 0..1, at cube points [n, 3]."""
        places, squares = self.space.unwarp(x), np.full(len(x), np.inf)
        for center in self.centers:
            np.minimum(squares, np.square(places - np.asarray(center)).sum(1), out=squares)
        return np.exp(-squares / self.reach**2).astype(np.float32)

    def describe(self) -> dict:
        """As JSON keeps it."""
        centers = [[float(v) for v in center] for center in self.centers]
        return {"space": self.space.describe(), "centers": centers, "reach": float(self.reach)}

    @classmethod
    def restore(cls, data: dict) -> "SpaceFilter":
        centers = tuple(map(tuple, validation.rows(data, "centers", None, 3)))
        return cls(
            SpaceWarp.restore(validation.entry(data, "space")),
            centers,
            validation.number(data, "reach", 1 / validation.LARGEST),
        )


@dataclass(frozen=True)
class Recoloring:
    """One edit. changes: of palette colors and weights. offset_scale, view_scale: factors of the offsets delta and of
    the view-dependent part. within: where the edit applies; None: everywhere."""

    changes: PaletteEdits = field(default_factory=PaletteEdits)
    offset_scale: float = 1.0
    view_scale: float = 1.0
    within: SpaceFilter | None = None

    def share(self, x: np.ndarray) -> "Tensor":
        """Return the edit's strength [n, 1], float32 in 0..1, at cube points [n, 3]."""
        import torch

        found = np.ones(len(x), np.float32) if self.within is None else self.within(x)
        return torch.from_numpy(found)[:, None]

    def describe(self) -> dict:
        """As JSON keeps it."""
        return {
            "changes": self.changes.describe(),
            "offset_scale": float(self.offset_scale),
            "view_scale": float(self.view_scale),
            "within": None if self.within is None else self.within.describe(),
        }

    @classmethod
    def restore(cls, data: dict) -> "Recoloring":
        within = validation.entry(data, "within")
        offset_scale, view_scale = (validation.number(data, f"{what}_scale", 0) for what in ("offset", "view"))
        changes = PaletteEdits.restore(validation.entry(data, "changes"))
        return cls(changes, offset_scale, view_scale, None if within is None else SpaceFilter.restore(within))


def recolored(
    weights: "Tensor",  # [n, M], rows add up to 1
    offsets: "Tensor",  # [n, M, 3]
    intensity: "Tensor",  # [n, 1]
    specular: "Tensor",  # [n, 3]
    palette: "Tensor",  # [M, 3]
    edits: Sequence[Recoloring],
    x: np.ndarray,  # [n, 3] in the cube
) -> "Tensor":
    """Return sum_i w_i I (P_i + delta_i) + s [n, 3] after the edits, applied in order; not clamped."""
    import torch

    shares = [edit.share(x).to(weights) for edit in edits]
    for edit, share in zip(edits, shares):
        offsets = offsets * (1 + share * (edit.offset_scale - 1))[..., None]
        specular = specular * (1 + share * (edit.view_scale - 1))
    bases = list((intensity[..., None] * (palette + offsets)).unbind(1))
    # The current palette at each point: a later edit builds on this one only where this one applies.
    present = list(palette.expand(len(weights), *palette.shape).unbind(1))
    for edit, share in zip(edits, shares):
        edit.changes.check(len(bases))
        weights = (1 - share) * weights + share * _weights(edit.changes, weights)
        for index, color in edit.changes.colors.items():
            new = torch.as_tensor(color, dtype=weights.dtype)
            bases[index] = (1 - share) * bases[index] + share * shifted(bases[index], present[index], new)
            present[index] = (1 - share) * present[index] + share * new
    return sum(weights[:, i : i + 1] * basis for i, basis in enumerate(bases)) + specular


def _weights(changes: PaletteEdits, weights: "Tensor") -> "Tensor":
    """PaletteEdits.weights for tensors, differentiable."""
    import torch

    if not changes.scales and not changes.biases:
        return weights
    scales, biases = torch.ones(weights.shape[1]).to(weights), torch.zeros(weights.shape[1]).to(weights)
    for to, values in ((scales, changes.scales), (biases, changes.biases)):
        for index, value in values.items():
            to[index] = value
    changed = (scales * weights + biases).clamp_min(0)
    total = changed.sum(1, keepdim=True)
    return torch.where(total > 1e-6, changed / total.clamp_min(1e-6), weights)


def shifted(colors: "Tensor", old: "Tensor", new: "Tensor") -> "Tensor":
    """Return colors [n, 3] after a palette color changes from `old` [n, 3] or [3] to `new` [3]: hue rotated by the
    difference of the two hues, saturation and value scaled by their ratios.

    Grays have neither hue nor saturation: where `old` is nearly gray, both are taken from `new`.
    """
    import torch

    (hue, saturation, value), (hue_old, saturation_old, value_old), (hue_new, saturation_new, value_new) = (
        to_hsv(one) for one in (colors, old, new)
    )
    gray = saturation_old < GRAYISH
    turned = torch.remainder(hue + hue_new - hue_old, 1.0)
    scaled = (saturation * saturation_new / saturation_old.clamp_min(GRAYISH)).clamp(0, 1)
    return from_hsv(
        torch.where(gray, hue_new.expand_as(turned), turned),
        torch.where(gray, saturation_new.expand_as(scaled), scaled),
        value * value_new / value_old.clamp_min(DARKEST),
    )


def to_hsv(colors: "Tensor") -> "tuple[Tensor, Tensor, Tensor]":
    """Return hue in 0..1, saturation in 0..1 and value >= 0, each [...], of colors [..., 3]; negatives count as 0."""
    import torch

    red, green, blue = colors.clamp_min(0).unbind(-1)
    value = torch.maximum(torch.maximum(red, green), blue)
    chroma = value - torch.minimum(torch.minimum(red, green), blue)
    safe = chroma.clamp_min(1e-8)
    sixths = torch.where(
        value == red,
        torch.remainder((green - blue) / safe, 6.0),
        torch.where(value == green, (blue - red) / safe + 2, (red - green) / safe + 4),
    )
    return torch.where(chroma > 1e-8, sixths / 6, torch.zeros_like(sixths)), chroma / value.clamp_min(1e-8), value


def from_hsv(hue: "Tensor", saturation: "Tensor", value: "Tensor") -> "Tensor":
    """Return colors [..., 3]; the inverse of to_hsv."""
    import torch

    channels = []
    # A channel is at its maximum within a sixth of the hue circle of its own hue, then falls to v (1 - s) over the
    # next sixth.
    for begin in (5.0, 3.0, 1.0):
        k = torch.remainder(begin + 6 * hue, 6.0)
        channels.append(value - value * saturation * torch.minimum(k, 4 - k).clamp(0, 1))
    return torch.stack(channels, -1)
