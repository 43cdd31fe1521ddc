"""Networks that an evaluation looks through: perceptual distances, and the features of the painting."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from schemas.errors import UsageError
from stages import weights
from stylerf.metrics.perceptual import PerceptualDistance
from stylerf.style.images import fitted
from stylerf.style.losses import by_block, gram_matrix, nearest_neighbour_distance, position_weights
from stylerf.style.matching import StyleRows, style_rows
from stylerf.style.trunks import Trunk

SMALLEST_SIDE = 64  # pixels: below it the deepest layers of the networks have nothing left to see
TAPS = "conv3"  # conv3_1, conv3_2, conv3_3 joined along channels, as ARF stylises by


@dataclass(frozen=True, eq=False)
class Perceptual:
    """A perceptual distance by name, on numpy images [h, w, 3] in 0..1."""

    name: str
    words: str
    network: PerceptualDistance
    device: str

    @torch.no_grad()
    def distance(self, a: np.ndarray, b: np.ndarray) -> float:
        """Distance of two whole images, >= 0."""
        return float(self.network(_batch(a, self.device), _batch(b, self.device))[0])

    @torch.no_grad()
    def pixels(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """The distance at each pixel, [h, w]."""
        return self.network.maps(_batch(a, self.device), _batch(b, self.device))[0].cpu().numpy()


def perceptual_distances(device: str) -> tuple[Perceptual | None, Perceptual | None]:
    """ST-LPIPS and LPIPS, each None where its weights are not here."""
    # AlexNet first: at 504x378 on two cores ST-LPIPS on VGG-16 takes 2.4 times as long.
    names = sorted(weights.available_metrics(), key=lambda name: "alex" not in name)
    plain = next((name for name in names if name.startswith("lpips")), None)
    tolerant = next((name for name in names if name.startswith("st-lpips")), None)
    return _loaded(("st-lpips-alex", tolerant) if tolerant else (), device), _loaded((plain,) if plain else (), device)


def _loaded(names: tuple[str, ...], device: str) -> Perceptual | None:
    """The first of these metrics whose weights are here."""
    for name in names:
        try:
            found = weights.resolve_metric(name)
        except UsageError:
            continue
        break
    else:
        return None
    network = PerceptualDistance(found.state, found.kind).to(device).eval()
    return Perceptual(found.name, found.source, network, device)


class Painting:
    """A painting's features, and how far pictures are from them.

    Render and painting are both brought to `side` pixels on their longer side (a smaller render is not enlarged; the
    painting then shrinks with it), so that figures of one resolution can be compared with one another.
    """

    def __init__(self, image: np.ndarray, features: str, side: int, device: str) -> None:
        """image: [h, w, 3] sRGB 0..1."""
        found = weights.resolve(features or None)
        self.image, self.side, self.device = image, side, device
        self.trunk_name, self.trunk_words = found.name, found.source
        self.trunk = Trunk(found.state, TAPS, found.kind).to(device)
        self._prepared: dict[int, tuple[StyleRows, Tensor]] = {}

    @property
    def protocol(self) -> str:
        """How style distances are measured, in words."""
        return (
            f"features conv3_1..3 of {self.trunk_name} ({self.trunk_words}), render and painting at {self.side} pixels "
            "on the longer side or the render's own if smaller, positions weighted by alpha"
        )

    @torch.no_grad()
    def distances(self, image: np.ndarray, alpha: np.ndarray) -> tuple[float, float]:
        """NNFM distance (mean 1 - cosine to the nearest feature) and relative Gram distance of an image [h, w, 3]."""
        side = min(self.side, max(image.shape[:2]))
        rows, gram = self._at(side)
        small = fitted(_batch(image, self.device)[0], side)
        found = self._features(small)
        coverage = position_weights(torch.from_numpy(np.ascontiguousarray(alpha)).float().to(self.device), found)
        coverage = torch.where(coverage > 0.5, coverage, torch.zeros_like(coverage))  # not the background's features
        if float(coverage.sum()) <= 0:
            return float("nan"), float("nan")
        nearest, _ = nearest_neighbour_distance(found, rows, coverage)
        difference = torch.linalg.norm(gram_matrix(found, coverage) - gram) / torch.linalg.norm(gram)
        return float(nearest.sum() / coverage.sum()), float(difference)

    def _at(self, side: int) -> tuple[StyleRows, Tensor]:
        if side not in self._prepared:
            found = self._features(fitted(_batch(self.image, self.device)[0], side))
            self._prepared[side] = (style_rows(found, most=None), gram_matrix(found))
        return self._prepared[side]

    def _features(self, image: Tensor) -> Tensor:
        return by_block(self.trunk.taps, self.trunk(image[None]))["conv3"]


def _batch(image: np.ndarray, device: str) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(image, np.float32)).permute(2, 0, 1)[None].to(device)
