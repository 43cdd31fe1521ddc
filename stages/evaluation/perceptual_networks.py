"""Networks that an evaluation looks through: perceptual distances, and the features of the painting."""

from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from schemas.errors import UsageError
from stages.weights import resolve
from stylerf.metrics.frechet import Moments, frechet_squared, moments
from stylerf.metrics.perceptual import PerceptualDistance
from stylerf.style.feature_extractor import FeatureExtractor
from stylerf.style.feature_matching import StyleRows, style_rows
from stylerf.style.image_sizes import fitted
from stylerf.style.losses import by_block, gram_matrix, nearest_neighbor_distance, position_weights

# conv3_1, conv3_2, conv3_3 joined along channels, as ARF stylizes by; conv2_2, just before the second halving, as SIFID
# takes from its own network.
TAPS = ("conv2_2", "conv3")


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
    tolerant, plain = (_loaded(found, device) for found in _perceptual_weights())
    return tolerant, plain


def networks_found(perceptual: bool, painted: bool, features: str) -> str:
    """Names and digests of the networks that an evaluation looks through: perceptual ones, and a painting's features.

    UsageError where a painting is to be looked at and there is no such trunk.
    """
    found = [one for one in _perceptual_weights() if one] if perceptual else []
    found += [resolve.resolve(features or None)] if painted else []
    return ", ".join(f"{one.name} {one.digest[:16]}" for one in found)


def _perceptual_weights() -> tuple[resolve.ResolvedExtractor | None, resolve.ResolvedExtractor | None]:
    # AlexNet first: at 504x378 on two cores ST-LPIPS on VGG-16 takes 2.4 times as long.
    names = sorted(resolve.available_metrics(), key=lambda name: "alex" not in name)
    plain = next((name for name in names if name.startswith("lpips")), None)
    tolerant = next((name for name in names if name.startswith("st-lpips")), None)
    return _first_of(("st-lpips-alex", tolerant) if tolerant else ()), _first_of((plain,) if plain else ())


def _first_of(names: tuple[str, ...]) -> resolve.ResolvedExtractor | None:
    """The first of these metrics whose weights are here."""
    for name in names:
        with suppress(UsageError):
            return resolve.resolve_metric(name)
    return None


def _loaded(found: resolve.ResolvedExtractor | None, device: str) -> Perceptual | None:
    if found is None:
        return None
    network = PerceptualDistance(found.state, found.kind).to(device).eval()
    return Perceptual(found.name, found.source, network, device)


@dataclass(frozen=True, eq=False)
class Prepared:
    """What is kept of the painting at one size: rows to match against, Gram matrix, moments of conv2_2."""

    rows: StyleRows
    gram: Tensor
    moments: Moments


class Painting:
    """A painting's features, and how far pictures are from them.

    Render and painting are both brought to `side` pixels on their longer side (a smaller render is not enlarged; the
    painting then shrinks with it), so that figures of one resolution can be compared with one another.
    """

    def __init__(self, image: np.ndarray, features: str, side: int, device: str) -> None:
        """image: [h, w, 3] sRGB 0..1."""
        found = resolve.resolve(features or None)
        self.image, self.side, self.device = image, side, device
        self.trunk_name, self.trunk_words = found.name, found.source
        self.trunk = FeatureExtractor(found.state, TAPS, found.kind).to(device)
        self._prepared: dict[int, Prepared] = {}

    @property
    def protocol(self) -> str:
        """How style distances are measured, in words."""
        return (
            f"features conv3_1..3 of {self.trunk_name} ({self.trunk_words}), both pictures at {self.side} pixels on "
            "the longer side or the render's own if smaller, positions weighted by alpha"
        )

    @torch.no_grad()
    def distances(self, image: np.ndarray, alpha: np.ndarray) -> tuple[float, float, float]:
        """Distances of an image [h, w, 3]: NNFM (mean 1 - cosine to the nearest feature), relative Gram, SIFID-style.

        SIFID-style: squared Frechet distance between the features of conv2_2 at the positions of the two pictures.
        """
        side = min(self.side, max(image.shape[:2]))
        painting = self._at(side)
        fine, found = self._features(fitted(_batch(image, self.device)[0], side))
        coverage, seen = (self._coverage(alpha, features) for features in (found, fine))
        if float(coverage.sum()) <= 0 or float(seen.sum()) <= 0:
            return (float("nan"),) * 3
        nearest, _ = nearest_neighbor_distance(found, painting.rows, coverage)
        gram = painting.gram
        difference = torch.linalg.norm(gram_matrix(found, coverage) - gram) / torch.linalg.norm(gram)
        sifid = frechet_squared(_moments(fine, seen > 0), painting.moments)
        return float(nearest.sum() / coverage.sum()), float(difference), sifid

    def _coverage(self, alpha: np.ndarray, features: Tensor) -> Tensor:
        """Weight of each position of the features, 0 where it is half the background's or more."""
        part = position_weights(torch.from_numpy(np.ascontiguousarray(alpha)).float().to(self.device), features)
        return torch.where(part > 0.5, part, torch.zeros_like(part))

    def _at(self, side: int) -> Prepared:
        if side not in self._prepared:
            fine, found = self._features(fitted(_batch(self.image, self.device)[0], side))
            everywhere = torch.ones(fine.shape[1:], dtype=torch.bool, device=fine.device)
            self._prepared[side] = Prepared(
                style_rows(found, most=None), gram_matrix(found), _moments(fine, everywhere)
            )
        return self._prepared[side]

    def _features(self, image: Tensor) -> tuple[Tensor, Tensor]:
        """[c, h, w] of conv2_2, and of conv3's layers joined."""
        found = by_block(self.trunk.layers, self.trunk(image[None]))
        return found["conv2"], found["conv3"]


def _moments(features: Tensor, where: Tensor) -> Moments:
    return moments(features[:, where].T.cpu().numpy())


def _batch(image: np.ndarray, device: str) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(image, np.float32)).permute(2, 0, 1)[None].to(device)
