"""Metrics of a single view, and of a view and its predecessor."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from stages.evaluation.metrics import Row, is_number
from stages.evaluation.test_views import Photo, Render
from stylerf.errors import InvalidValue
from stylerf.metrics import image_quality
from stylerf.metrics.color_distribution import color_quantiles, distance_of_quantiles
from stylerf.metrics.colorfulness import colorfulness
from stylerf.metrics.consistency import seen_through
from stylerf.metrics.depth import depth_errors, shape_change
from stylerf.metrics.edges_kept import edges_kept
from stylerf.metrics.frechet import Moments, color_moments, distance_of_moments
from stylerf.metrics.speckle import speckle

HIGHEST_PSNR = 100.0  # dB, for equal images: their PSNR is infinite, which neither a mean nor JSON can represent
Score = Callable[[np.ndarray, np.ndarray], float]
# image, alpha -> NNFM, Gram, Gram of the judge, SIFID
StyleDistances = Callable[[np.ndarray, np.ndarray], tuple[float, float, float, float]]


@dataclass
class ViewRow:
    """Values of one view by metric key, None where one could not be measured, and remarks that say why."""

    name: str
    values: dict[str, float | None] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)

    def measure(self, keys: tuple[str, ...], function: Callable[[], object], unmeasured: str = "") -> None:
        """Store what `function` returns under `keys`; if it raises InvalidValue, store None and a remark.

        unmeasured: the remark if the first value is not a number.
        """
        try:
            found = function()
        except InvalidValue as error:
            self.values.update(dict.fromkeys(keys))
            self._remark(str(error))
            return
        values = found if isinstance(found, tuple) else (found,)
        for key, value in zip(keys, values, strict=True):
            self.values[key] = float(value) if is_number(value) else None
        if unmeasured and self.values[keys[0]] is None:
            self._remark(unmeasured)

    def skip(self, keys: tuple[str, ...], remark: str) -> None:
        """Record that these metrics cannot be measured in this view, and why."""
        self.values.update(dict.fromkeys(keys))
        self._remark(remark)

    def _remark(self, text: str) -> None:
        if text not in self.remarks:
            self.remarks.append(text)

    def row(self) -> Row:
        """For the report."""
        return {"name": self.name, **self.values, "remark": "; ".join(self.remarks)}


def nonfinite_message(render: Render) -> str:
    """Remark on a render with NaN or infinite pixels."""
    return f"{render.nonfinite} of {render.alpha.size} pixels of the render are NaN or infinite"


def skipped_nonfinite(row: ViewRow, keys: tuple[str, ...], render: Render, other: Render, name: str) -> bool:
    """Skip metrics of two renders if either has NaN or infinite pixels. name: of the other one in the remark."""
    if not (render.nonfinite or other.nonfinite):
        return False
    row.skip(keys, nonfinite_message(render) if render.nonfinite else f"{name}: {nonfinite_message(other)}")
    return True


def measure_fit(row: ViewRow, render: Render, photo: Photo, scores: Mapping[str, Score]) -> None:
    """Compare a render with its photo: PSNR, SSIM, perceptual scores by key, depth errors."""
    keys = ("psnr", *(("psnr_object",) if photo.mask is not None else ()), "ssim", *scores)
    depth_keys = ("depth_abs_rel", "depth_rmse", "depth_delta", "depth_in_front", "depth_share")
    if render.nonfinite:
        row.skip((*keys, *(depth_keys if photo.depth is not None else ())), nonfinite_message(render))
        return
    reference = photo.filled_from(render.image)
    row.measure(("psnr",), lambda: min(image_quality.psnr(render.image, photo.image, photo.visible), HIGHEST_PSNR))
    if photo.mask is not None and photo.mask.any():
        row.measure(
            ("psnr_object",), lambda: min(image_quality.psnr(render.image, photo.image, photo.mask), HIGHEST_PSNR)
        )
    row.measure(("ssim",), lambda: image_quality.ssim(render.image, reference, photo.visible))
    for key, score in scores.items():
        row.measure((key,), partial(score, render.image, reference))
    if photo.depth is not None:
        depths = partial(_depth_values, render, photo.depth)
        row.measure(depth_keys, depths, "no pixel of a known depth is opaque in the render")


def _depth_values(render: Render, truth: np.ndarray) -> tuple:
    found = depth_errors(render.z, render.alpha, truth)
    return found.abs_rel, found.rmse, found.delta, found.in_front, found.share


def measure_palette(row: ViewRow, image: np.ndarray, alpha: np.ndarray, style: Moments, most: float) -> None:
    """Compare an image's colors, where alpha > 0.5, with those of the style image: its moments and colorfulness."""
    keys = ("palette", "palette_mean", "palette_covariance", "colorfulness")

    def distances() -> tuple:
        own = image[alpha > 0.5]
        found = distance_of_moments(color_moments(own), style)
        return found.frechet, found.mean, found.covariance, colorfulness(own) / most if most > 0 else None

    row.measure(keys, distances)


def measure_colors(row: ViewRow, image: np.ndarray, alpha: np.ndarray, style_quantiles: np.ndarray) -> None:
    """Compare the distribution of an image's colors, where alpha > 0.5, with that of the style image."""
    row.measure(
        ("color_distribution",), lambda: distance_of_quantiles(color_quantiles(image[alpha > 0.5]), style_quantiles)
    )


def measure_speckle(
    row: ViewRow, image: np.ndarray, alpha: np.ndarray, photo: Photo | None, style_speckle: float
) -> None:
    """Speckle of an image, where it is opaque, beyond that of its photo and of the style image."""

    def excess() -> float:
        opaque = alpha > 0.5
        visible = opaque if photo is None or photo.visible is None else opaque & photo.visible
        own = [] if photo is None else [speckle(photo.image, visible)]
        return max(0.0, speckle(image, opaque) - max([style_speckle, *own]))

    row.measure(("speckle",), excess)


def measure_style(row: ViewRow, image: np.ndarray, alpha: np.ndarray, distances: StyleDistances) -> None:
    """NNFM, Gram and SIFID-style distances of an image, where it is opaque, to the style image."""
    row.measure(("nnfm", "gram", "judge_gram", "sifid"), lambda: distances(image, alpha), "the render is transparent")


def measure_content(row: ViewRow, image: np.ndarray, photo: Photo) -> None:
    """Content SSIM and edges kept: how much of the photo's structure a stylized image has."""
    row.measure(("content_ssim",), lambda: image_quality.content_ssim(image, photo.filled_from(image), photo.visible))
    # The silhouette of an object is kept by its density, whatever its colors: only edges within it count.
    seen = photo.visible if photo.mask is None else photo.mask
    row.measure(("edges_kept",), lambda: edges_kept(image, photo.filled_from(image), seen))


def measure_shape(row: ViewRow, render: Render, base: Render) -> None:
    """Change of depth between the unstylized and the stylized render of a view."""
    skipped = skipped_nonfinite(row, ("shape_change",), render, base, "unstylized")
    if not skipped and base.z.shape == render.z.shape:
        row.measure(("shape_change",), lambda: shape_change(render.z, render.alpha, base.z, base.alpha))


def measure_see_through(row: ViewRow, render: Render, previous: Render) -> None:
    """Fraction of seen-through surface points: a sign of floaters, from a view and the one before it."""
    if not skipped_nonfinite(row, ("see_through",), render, previous, "previous view"):
        row.measure(("see_through",), lambda: seen_through(render.posed(), previous.posed()))


def spread(count: int, limit: int) -> list[int]:
    """At most `limit` (0: all) of the indices below `count`, evenly spread from first to last."""
    if limit == 0 or count <= limit:
        return list(range(count))
    return sorted({round(index) for index in np.linspace(0, count - 1, limit).tolist()})
