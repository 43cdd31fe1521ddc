"""The figures of one view, and of one pair of views."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from stages.evaluation.metrics import Row, is_number
from stages.evaluation.test_views import Photo, Render
from stylerf.errors import InvalidValue
from stylerf.metrics import image_quality
from stylerf.metrics.consistency import seen_through
from stylerf.metrics.depth import depth_errors, shape_change
from stylerf.metrics.palette_distance import palette_distance

HIGHEST_PSNR = 100.0  # dB: equal images have an infinite PSNR, which no mean and no JSON can hold
Score = Callable[[np.ndarray, np.ndarray], float]
StyleDistances = Callable[[np.ndarray, np.ndarray], tuple[float, float, float]]  # image, alpha -> NNFM, Gram, SIFID


@dataclass
class ViewRow:
    """Values of one view by key, None where one could not be measured, and remarks that say why."""

    name: str
    values: dict[str, float | None] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)

    def measure(self, keys: tuple[str, ...], function: Callable[[], object]) -> None:
        """Keeps what `function` returns under `keys`; what cannot be measured leaves None and a remark."""
        try:
            found = function()
        except InvalidValue as error:
            self.values.update(dict.fromkeys(keys))
            self._remark(str(error))
            return
        values = found if isinstance(found, tuple) else (found,)
        for key, value in zip(keys, values, strict=True):
            self.values[key] = float(value) if is_number(value) else None

    def spoil(self, keys: tuple[str, ...], remark: str) -> None:
        """Says that none of these figures can be measured here."""
        self.values.update(dict.fromkeys(keys))
        self._remark(remark)

    def _remark(self, text: str) -> None:
        if text not in self.remarks:
            self.remarks.append(text)

    def row(self) -> Row:
        """For the report."""
        return {"name": self.name, **self.values, "remark": "; ".join(self.remarks)}


def spoiled_words(render: Render) -> str:
    """What is wrong with a render that is not finite everywhere."""
    return f"{render.spoiled} of {render.alpha.size} pixels of the render are not finite (NaN or infinite)"


def measure_fit(row: ViewRow, render: Render, photo: Photo, scores: Mapping[str, Score]) -> None:
    """Figures of a render that should look like the photo: PSNR, SSIM, perceptual scores by key, depth errors."""
    keys = ("psnr", *(("psnr_object",) if photo.mask is not None else ()), "ssim", *scores)
    depth_keys = ("depth_abs_rel", "depth_rmse", "depth_delta", "depth_in_front", "depth_share")
    if render.spoiled:
        row.spoil((*keys, *(depth_keys if photo.depth is not None else ())), spoiled_words(render))
        return
    beside = photo.beside(render.image)
    row.measure(("psnr",), lambda: min(image_quality.psnr(render.image, photo.image, photo.shown), HIGHEST_PSNR))
    if photo.mask is not None and photo.mask.any():
        row.measure(
            ("psnr_object",), lambda: min(image_quality.psnr(render.image, photo.image, photo.mask), HIGHEST_PSNR)
        )
    row.measure(("ssim",), lambda: image_quality.ssim(render.image, beside, photo.shown))
    for key, score in scores.items():
        row.measure((key,), lambda score=score: score(render.image, beside))
    if photo.depth is not None:
        row.measure(depth_keys, lambda: _depth_values(render, photo.depth))


def _depth_values(render: Render, truth: np.ndarray) -> tuple:
    found = depth_errors(render.z, render.alpha, truth)
    return found.abs_rel, found.rmse, found.delta, found.in_front, found.share


def measure_palette(row: ViewRow, image: np.ndarray, alpha: np.ndarray, painting: np.ndarray) -> None:
    """Distance of an image's colors, where alpha > 0.5, from the painting's [h, w, 3]."""
    keys = ("palette", "palette_mean", "palette_covariance")

    def distances() -> tuple:
        found = palette_distance(image[alpha > 0.5], painting.reshape(-1, 3))
        return found.frechet, found.mean, found.covariance

    row.measure(keys, distances)


def measure_style(row: ViewRow, image: np.ndarray, alpha: np.ndarray, distances: StyleDistances) -> None:
    """NNFM, Gram and SIFID-style distance of an image, where it is opaque, to the painting."""
    row.measure(("nnfm", "gram", "sifid"), lambda: distances(image, alpha))


def measure_content(row: ViewRow, image: np.ndarray, photo: Photo) -> None:
    """Structure of the photo that a stylized image kept."""
    row.measure(("content_ssim",), lambda: image_quality.content_ssim(image, photo.beside(image), photo.shown))


def measure_shape(row: ViewRow, render: Render, base: Render) -> None:
    """Depth of a stylized render against that of its unstylized twin."""
    if render.spoiled or base.spoiled:
        words = spoiled_words(render) if render.spoiled else f"unstylized: {spoiled_words(base)}"
        row.spoil(("shape_change",), words)
    elif base.z.shape == render.z.shape:
        row.measure(("shape_change",), lambda: shape_change(render.z, render.alpha, base.z, base.alpha))


def measure_see_through(row: ViewRow, render: Render, other: Render) -> None:
    """Signs of floaters from a view and its neighbor."""
    if render.spoiled or other.spoiled:
        words = spoiled_words(render) if render.spoiled else f"the view before it: {spoiled_words(other)}"
        row.spoil(("see_through",), words)
        return
    row.measure(("see_through",), lambda: seen_through(render.posed(), other.posed()))


def spread(count: int, most: int) -> list[int]:
    """At most `most` (0: all) of the numbers below `count`, evenly spread from the first to the last."""
    if most == 0 or count <= most:
        return list(range(count))
    return sorted({round(place) for place in np.linspace(0, count - 1, most).tolist()})
