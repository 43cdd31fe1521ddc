"""What stands behind the subject in a set of pictures: transparency, plain white or black, or simply the world."""

import numpy as np

from schemas.errors import BadInput
from stylerf.geometry.hull import silhouette

# Of the pixels on a picture's border, the share that must be plain, in at least the median picture.
PLAIN_SHARE = 0.97
_PLAIN = 0.02
_FOREGROUND = 0.06


class Backdrop:
    """Gathers evidence picture by picture (`seen`), then `decide`s.

    kind: alpha, white, black or none. cuts_out: in words, by what the object is told from the background, else empty.
    """

    def __init__(self, wanted: str) -> None:
        self.wanted, self.kind, self.cuts_out = wanted, "none", ""
        self._with_alpha = 0
        self._white: list[float] = []
        self._black: list[float] = []
        self._masks: dict[str, list[np.ndarray]] = {"alpha": [], "white": [], "black": []}

    def seen(self, pixels: np.ndarray) -> np.ndarray:
        """Takes note of a picture, [h, w, 3 or 4] with straight alpha, and returns it as the scene holds it."""
        alpha = pixels[..., 3] if pixels.shape[2] == 4 else np.ones(pixels.shape[:2], np.float32)
        self._with_alpha += pixels.shape[2] == 4
        colour = pixels[..., :3]
        border = np.concatenate([colour[0], colour[-1], colour[:, 0], colour[:, -1]])
        self._white.append(float((border > 1 - _PLAIN).all(-1).mean()))
        self._black.append(float((border < _PLAIN).all(-1).mean()))
        self._masks["alpha"].append(silhouette(alpha))
        self._masks["white"].append(silhouette(1 - colour.min(-1), _FOREGROUND))
        self._masks["black"].append(silhouette(colour.max(-1), _FOREGROUND))
        if pixels.shape[2] == 4 and self.wanted in ("white", "black", "none"):
            behind = 1.0 if self.wanted == "white" else 0.0
            return colour * alpha[..., None] + behind * (1 - alpha[..., None])
        return pixels

    def decide(self) -> None:
        """Sets kind and cuts_out; BadInput where alpha was asked for and no picture has any."""
        count = len(self._white)
        if self.wanted == "alpha" and not self._with_alpha:
            raise BadInput("--background alpha: no photo has transparency or a mask; add masks/NAME.png, or drop it")
        if self._with_alpha:
            self.kind = "alpha" if self.wanted in ("auto", "alpha") else self.wanted
            # Masks of single photos hide passers-by; only where most have one is it the object that is cut out.
            self.cuts_out = "transparency" if self._with_alpha > count / 2 else ""
            return
        for kind, shares in (("white", self._white), ("black", self._black)):
            plain = float(np.median(shares)) >= PLAIN_SHARE
            if self.wanted == kind or (self.wanted == "auto" and plain):
                self.kind = kind
                self.cuts_out = f"a plain {kind} background" if plain else ""
                return

    def silhouettes(self) -> list[np.ndarray]:
        """Of every picture, at most 256 pixels a side."""
        return self._masks["alpha" if self._with_alpha else self.kind]
