"""Detects the background of a set of pictures: transparency, plain white or black, or the surroundings."""

from dataclasses import dataclass

import numpy as np

from schemas.errors import BadInput
from stylerf.geometry.silhouette_bounds import silhouette

# The share of a picture's border pixels that must be plain, in at least the median picture.
PLAIN_SHARE = 0.97
_PLAIN = 0.02
_FOREGROUND = 0.06
# An object is cut out if in the median picture this much of the border is transparent, and this much of the whole. A
# tripod, a car's hood or passers-by take little of either, the blank rim of an undistorted photo little of the whole,
# the sky at most about the border's upper half.
CUT_BORDER = 2 / 3
CUT_SHARE = 0.2
# Masks that differ by less than this share of their pixels are the same mask, of the camera and not of a subject.
_ONE_MASK = 0.002


@dataclass(frozen=True, eq=False)
class Evidence:
    """What one picture says about the background.

    Attributes:
        with_alpha: Whether it has alpha.
        cut: Transparent fractions of its border and of the whole.
        white, black: Plain fractions of its border.
        masks: Silhouettes by kind. With alpha, only that of alpha; the others are ignored.
    """

    with_alpha: bool
    cut: tuple[float, float]
    white: float
    black: float
    masks: dict[str, np.ndarray]


def evidence_of(pixels: np.ndarray) -> Evidence:
    """Look at a picture, [h, w, 3 or 4] with straight alpha."""
    with_alpha = pixels.shape[2] == 4
    alpha = pixels[..., 3] if with_alpha else np.broadcast_to(np.float32(1), pixels.shape[:2])
    border = _border(pixels[..., :3])
    masks = {"alpha": silhouette(alpha)}
    if not with_alpha:
        # Channel by channel: numpy is ten times as slow along an axis of three.
        red, green, blue = pixels[..., 0], pixels[..., 1], pixels[..., 2]
        masks["white"] = silhouette(1 - np.minimum(np.minimum(red, green), blue), _FOREGROUND)
        masks["black"] = silhouette(np.maximum(np.maximum(red, green), blue), _FOREGROUND)
    return Evidence(
        with_alpha,
        (float((_border(alpha) < 0.5).mean()), float((alpha < 0.5).mean())),
        float((border > 1 - _PLAIN).all(-1).mean()),
        float((border < _PLAIN).all(-1).mean()),
        masks,
    )


class Background:
    """Gathers evidence picture by picture (`seen`), then `decide`s.

    kind: alpha, white, black or none. cuts_out: a description of what separates the object from its background; empty
    if nothing does. remark: a message about transparency that does not cut out an object, else empty.
    """

    def __init__(self, wanted: str) -> None:
        self.wanted, self.kind, self.cuts_out = wanted, "none", ""
        self.remark = ""
        self._with_alpha = 0
        self._cut: list[tuple[float, float]] = []
        self._white: list[float] = []
        self._black: list[float] = []
        self._masks: dict[str, list[np.ndarray]] = {"alpha": [], "white": [], "black": []}

    def seen(self, evidence: Evidence) -> None:
        """Record the evidence of a picture."""
        self._with_alpha += evidence.with_alpha
        self._cut.append(evidence.cut)
        self._white.append(evidence.white)
        self._black.append(evidence.black)
        for kind, mask in evidence.masks.items():
            self._masks[kind].append(mask)

    def shown(self, pixels: np.ndarray) -> np.ndarray:
        """Return a picture, [h, w, 3 or 4] with straight alpha, as the scene holds it."""
        if pixels.shape[2] == 4 and self.wanted in ("white", "black", "none"):
            color, alpha, behind = pixels[..., :3], pixels[..., 3:], 1.0 if self.wanted == "white" else 0.0
            return color * alpha + behind * (1 - alpha)
        return pixels

    def decide(self) -> None:
        """Set kind and cuts_out; BadInput if alpha is requested and no picture has any."""
        if self.wanted == "alpha" and not self._with_alpha:
            raise BadInput("--background alpha: no photo has transparency or a mask; add masks/NAME.png, or drop it")
        if self._with_alpha:
            self.kind = "alpha" if self.wanted in ("auto", "alpha") else self.wanted
            border, share = np.median(self._cut, axis=0)
            if border >= CUT_BORDER and share >= CUT_SHARE and not self._lens_hood():
                self.cuts_out = "transparency"
            else:
                self.remark = self._hidden()
            return
        for kind, shares in (("white", self._white), ("black", self._black)):
            plain = float(np.median(shares)) >= PLAIN_SHARE
            if self.wanted == kind or (self.wanted == "auto" and plain):
                self.kind = kind
                self.cuts_out = f"a plain {kind} background" if plain else ""
                return

    def _lens_hood(self) -> bool:
        """Return whether one mask that reaches the border hides the same part of nearly every picture."""
        return self.one_mask() and bool(_border(self._masks["alpha"][0]).any())

    def one_mask(self) -> bool:
        """Return whether transparency hides the same part of nearly every picture."""
        masks = self._masks["alpha"]
        first = masks[0]
        alike = [mask.shape == first.shape and (mask != first).mean() < _ONE_MASK for mask in masks]
        return len(masks) > 1 and bool(np.mean(alike) > 0.9)

    def _hidden(self) -> str:
        border, share = np.mean(self._cut, axis=0)
        return (
            f"masks or transparency in {self._with_alpha} of {len(self._cut)} photos ({share:.2%} of all pixels, "
            f"{border:.2%} of the borders) are taken to hide parts of a room or landscape, not to cut out an object; "
            "if they do cut one out, give --layout object"
        )

    def silhouettes(self) -> list[np.ndarray]:
        """Of every picture, at most 256 pixels a side."""
        return self._masks["alpha" if self._with_alpha else self.kind]


def _border(pixels: np.ndarray) -> np.ndarray:
    """The outermost pixels of [h, w, ...], in no particular order."""
    return np.concatenate([pixels[0], pixels[-1], pixels[:, 0], pixels[:, -1]])
