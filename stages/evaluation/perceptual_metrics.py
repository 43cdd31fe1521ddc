"""The perceptual networks of an evaluation, and its style image."""

import functools
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from schemas.errors import BadInput, UsageError
from schemas.work_folder import Artifact
from stages.artifacts.style_images import read_shown
from stages.configs.evaluate import SMALLEST_SIDE, EvaluateConfig
from stages.evaluation.judge import Judge, judge_beside, networks_that_stylized
from stages.evaluation.view_metrics import Score
from stages.run.progress import Context
from stages.weights import resolve
from stylerf.metrics.color_distribution import color_quantiles
from stylerf.metrics.colorfulness import colorfulness
from stylerf.metrics.consistency import PixelDistance
from stylerf.metrics.flow_consistency import ImageDistance
from stylerf.metrics.frechet import Moments, color_moments, frechet_squared, moments
from stylerf.metrics.perceptual import PerceptualDistance
from stylerf.metrics.speckle import speckle
from stylerf.style.feature_extractor import FeatureExtractor, by_block, fitted
from stylerf.style.feature_matching import StyleRows, style_rows
from stylerf.style.style_features import style_features
from stylerf.style.style_loss import gram_matrix, nearest_neighbor_distance, position_weights

LAYERS = "conv3"  # conv3_1 to conv3_3 concatenated, as in ARF


@dataclass(frozen=True, eq=False)
class PerceptualNetwork:
    """A named perceptual distance on images [h, w, 3] in 0..1."""

    name: str
    source: str
    network: PerceptualDistance
    device: str

    @torch.no_grad()
    def distance(self, a: np.ndarray, b: np.ndarray) -> float:
        """Distance of two images, >= 0."""
        return float(self.network(_batch(a, self.device), _batch(b, self.device))[0])

    @torch.no_grad()
    def pixels(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Distance per pixel, [h, w]."""
        return self.network.maps(_batch(a, self.device), _batch(b, self.device))[0].cpu().numpy()


def perceptual_networks(device: str) -> tuple[PerceptualNetwork | None, PerceptualNetwork | None]:
    """Load ST-LPIPS and LPIPS; each is None if its weights are missing."""
    st_lpips, lpips = (_load(found, device) for found in _perceptual_weights())
    return st_lpips, lpips


def available_networks(perceptual: bool, style: bool, features: str, field: Artifact | None = None) -> str:
    """Names and digests of the networks of an evaluation: perceptual ones, that of the style features, the judge.

    Raises UsageError if style is measured and the feature network is missing.
    """
    found = [one for one in _perceptual_weights() if one] if perceptual else []
    if style:
        own = resolve.resolve(features or None)
        found += [own, _judge_of(own, field).network]
    return ", ".join(f"{one.name} {one.digest[:16]}" for one in found)


def _judge_of(own: resolve.ResolvedExtractor, field: Artifact | None) -> Judge:
    """Return the judge of a field. If the field records no network, the one that measures it is assumed."""
    return judge_beside(networks_that_stylized(field) or {own.digest}, own)


def _perceptual_weights() -> tuple[resolve.ResolvedExtractor | None, resolve.ResolvedExtractor | None]:
    # Prefer AlexNet: at 504x378 on two cores, ST-LPIPS on VGG-16 takes 2.4 times as long.
    names = sorted(resolve.available_metrics(), key=lambda name: "alex" not in name)
    lpips = next((name for name in names if name.startswith("lpips")), None)
    st_lpips = next((name for name in names if name.startswith("st-lpips")), None)
    return _first_of(("st-lpips-alex", st_lpips) if st_lpips else ()), _first_of((lpips,) if lpips else ())


def _first_of(names: tuple[str, ...]) -> resolve.ResolvedExtractor | None:
    """The first of these metrics whose weights are available."""
    for name in names:
        with suppress(UsageError):
            return resolve.resolve_metric(name)
    return None


def _load(found: resolve.ResolvedExtractor | None, device: str) -> PerceptualNetwork | None:
    if found is None:
        return None
    network = PerceptualDistance(found.state, found.kind).to(device).eval()
    return PerceptualNetwork(found.name, found.source, network, device)


@dataclass(frozen=True, eq=False)
class StyleFeatures:
    """Features of the style image at one size: rows to match against; Gram matrix, also of the judge; its moments."""

    rows: StyleRows
    gram: Tensor
    judge_gram: Tensor
    moments: Moments


class StyleImage:
    """A style image, and the distances of renders from it.

    Both are resized to `side` pixels on the longer side, or to the render's own size if smaller, so that values of one
    size are comparable.
    """

    def __init__(
        self, image: np.ndarray, features: str, side: int, device: str, field: Artifact | None = None
    ) -> None:
        """image: [h, w, 3] sRGB 0..1; [h, w, 4] if parts are transparent, which do not count. field: what is measured;
        the judge is not a network that stylized it."""
        found = resolve.resolve(features or None)
        self.image, self.side, self.device = image, side, device
        self.network_name, self.network_source = found.name, found.source
        self.extractor = FeatureExtractor(found.state, LAYERS, found.kind).to(device)
        self.judge = _judge_of(found, field)
        self._judging = FeatureExtractor(self.judge.network.state, self.judge.layer, self.judge.network.kind).to(device)
        self._features_by_side: dict[int, StyleFeatures] = {}
        self._speckle_by_side: dict[int, float] = {}

    @property
    def on_white(self) -> np.ndarray:
        """[h, w, 3], transparent parts white."""
        return self.image if self.image.shape[2] == 3 else np.where(self.image[..., 3:] > 0, self.image[..., :3], 1.0)

    @property
    def protocol(self) -> str:
        """How style distances are measured, for the report."""
        return (
            f"features conv3_1..3 of {self.network_name} ({self.network_source}), both images at {self.side} pixels on "
            "the longer side, or at the render's size if smaller, positions weighted by alpha"
        )

    @torch.no_grad()
    def distances(self, image: np.ndarray, alpha: np.ndarray) -> tuple[float, float, float, float]:
        """Distances of an image [h, w, 3] with alpha [h, w]: NNFM, relative Gram, that of the judge, SIFID-style.

        NNFM: mean of 1 - cosine to the nearest style feature. SIFID-style: squared Frechet distance between features of
        the judge. All NaN if the image is transparent.
        """
        side = min(self.side, max(image.shape[:2]))
        style = self._at(side)
        fine, found = self._features(fitted(_batch(image, self.device)[0], side))
        coverage, fine_coverage = (self._coverage(alpha, features) for features in (found, fine))
        if float(coverage.sum()) <= 0 or float(fine_coverage.sum()) <= 0:
            return (float("nan"),) * 4
        nearest, _ = nearest_neighbor_distance(found, style.rows, coverage)
        gram = _relative(gram_matrix(found, coverage), style.gram)
        judge_gram = _relative(gram_matrix(fine, fine_coverage), style.judge_gram)
        sifid = frechet_squared(_moments(fine, fine_coverage > 0), style.moments)
        return float(nearest.sum() / coverage.sum()), gram, judge_gram, sifid

    @functools.cached_property
    def colors(self) -> np.ndarray:
        """Quantiles of its colors, for the distance of color distributions."""
        return color_quantiles(self._opaque)

    @functools.cached_property
    def palette(self) -> tuple[Moments, float]:
        """Moments and colorfulness of its colors."""
        return color_moments(self._opaque), colorfulness(self._opaque)

    @property
    def _opaque(self) -> np.ndarray:
        """Colors [n, 3] of its opaque pixels."""
        if self.image.shape[2] == 3:
            return self.image.reshape(-1, 3)
        return self.image[self.image[..., 3] > 0.5][:, :3]

    def speckle(self, side: int) -> float:
        """Its speckle at `side` pixels on the longer side, or at its own size if smaller."""
        side = min(side, max(self.image.shape[:2]))
        if side not in self._speckle_by_side:
            scaled = fitted(_batch(self.on_white, "cpu")[0], side).clamp(0, 1)
            self._speckle_by_side[side] = speckle(scaled.permute(1, 2, 0).numpy())
        return self._speckle_by_side[side]

    def _coverage(self, alpha: np.ndarray, features: Tensor) -> Tensor:
        """Weight of each feature position, 0 where at most half of it is opaque."""
        weights = position_weights(torch.from_numpy(np.ascontiguousarray(alpha)).float().to(self.device), features)
        return torch.where(weights > 0.5, weights, torch.zeros_like(weights))

    def _at(self, side: int) -> StyleFeatures:
        if side not in self._features_by_side:
            picture = fitted(_batch(self.image, self.device)[0], side)
            (found,) = style_features(self.extractor, picture, limited=False).values()
            (fine,) = style_features(self._judging, picture, limited=False).values()
            everywhere = torch.ones(fine.shape[1:], dtype=torch.bool, device=fine.device)
            self._features_by_side[side] = StyleFeatures(
                style_rows(found, most=None), gram_matrix(found), gram_matrix(fine), _moments(fine, everywhere)
            )
        return self._features_by_side[side]

    def _features(self, image: Tensor) -> tuple[Tensor, Tensor]:
        """Features [c, h, w] of the judge, and of the layers of conv3 concatenated."""
        return self._judging(image[None])[0][0], by_block(self.extractor.layers, self.extractor(image[None]))["conv3"]


def _relative(found: Tensor, wanted: Tensor) -> float:
    return float(torch.linalg.norm(found - wanted) / torch.linalg.norm(wanted))


def _moments(features: Tensor, where: Tensor) -> Moments:
    return moments(features[:, where].T.cpu().numpy())


def _batch(image: np.ndarray, device: str) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(image, np.float32)).permute(2, 0, 1)[None].to(device)


STYLE_IMAGE = "the style image"


@dataclass(frozen=True, eq=False)
class PerceptualMetrics:
    """Perceptual networks and the style image; each None if not wanted or not available."""

    st_lpips: PerceptualNetwork | None
    lpips: PerceptualNetwork | None
    style_image: StyleImage | None
    style_name: str
    style_label: str = STYLE_IMAGE

    @classmethod
    def load(cls, config: EvaluateConfig, field: Artifact | None, context: Context) -> "PerceptualMetrics":
        """Load what the config requests and is installed; report the feature network of the style distances."""
        st_lpips, lpips = perceptual_networks(context.device) if config.perceptual != "none" else (None, None)
        path = style_file(config, field)
        if path is None:
            return cls(st_lpips, lpips, None, "")
        style_image = StyleImage(read_shown(path), config.features, config.style_side, context.device, field)
        context.progress.say(f"style distances to {path.name} use the features of {style_image.network_name}")
        return cls(st_lpips, lpips, style_image, path.name, style_label(config, field))

    @property
    def pixel_name(self) -> str:
        """Name of the perceptual distance between pairs of frames."""
        if self.lpips is not None:
            return f"LPIPS ({self.lpips.name})"
        return f"ST-LPIPS ({self.st_lpips.name})" if self.st_lpips is not None else "perceptual"

    def large_enough(self, shape: tuple[int, ...]) -> bool:
        """Whether images of this height and width are large enough for the networks."""
        return min(shape[:2]) >= SMALLEST_SIDE

    def scores(self, shape: tuple[int, ...]) -> Mapping[str, Score]:
        """Distances of whole images by metric key."""
        nets = {"stlpips": self.st_lpips, "lpips": self.lpips}
        return {key: net.distance for key, net in nets.items() if net is not None and self.large_enough(shape)}

    def pixel_distance(self, shape: tuple[int, ...]) -> PixelDistance | None:
        """LPIPS, or else ST-LPIPS, as a map over pixels; None if neither is available."""
        net = self.lpips or self.st_lpips
        return net.pixels if net is not None and self.large_enough(shape) else None

    def image_distance(self, shape: tuple[int, ...]) -> ImageDistance | None:
        """The same distance of whole images."""
        net = self.lpips or self.st_lpips
        return net.distance if net is not None and self.large_enough(shape) else None


def style_label(config: EvaluateConfig, field: Artifact | None) -> str:
    """What labels call the style image: a field stylized only by references is compared with the first of them."""
    made_with = {} if config.style or field is None else field.manifest.config
    return "the reference" if made_with.get("reference") and not made_with.get("style") else STYLE_IMAGE


def style_file(config: EvaluateConfig, field: Artifact | None) -> Path | None:
    """The style image: the one given, else `style.<extension>` in the field's folder.

    Raises BadInput if one was given and does not exist.
    """
    if config.style:
        path = Path(config.style).expanduser()
        if not path.is_file():
            raise BadInput(f"--style {config.style}: no such file; give the style image to compare with")
        return path
    if field is None:
        return None
    kept = [record.path for record in field.manifest.files if Path(record.path).stem == "style"]
    pictures = [name for name in kept if Path(name).suffix.lower() in (".png", ".jpg", ".jpeg")]
    return field.file(pictures[0]) if pictures else None
