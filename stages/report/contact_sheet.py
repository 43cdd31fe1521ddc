"""The contact sheet: which views it shows, and their thumbnails as JPEG data URIs."""

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from skimage.transform import resize

from stages.evaluation.metrics import Row, is_number, number_in
from stages.evaluation.test_views import Photo, Render
from stages.report.charts import Chart
from stages.report.pages import number
from stylerf.environment.matplotlib_defaults import colormaps, imsave

MAX_ERROR = 0.25  # mean absolute difference over RGB at the bright end of the color map
ERROR_COLORS, DEPTH_COLORS = "inferno", "viridis_r"  # perceptually uniform; viridis_r makes near bright
NOT_FINITE = (1.0, 0.0, 1.0)  # magenta: unlikely in photos, color maps and style images
EMPTY = (0.5, 0.5, 0.5)
ENCODINGS = ((480, 85), (360, 80), (280, 70), (200, 60))  # width in pixels and JPEG quality, best first
MAX_HEIGHT_REM = 22  # of an image on the contact sheet: portraits would fill the screen otherwise


@dataclass(frozen=True)
class Picture:
    """An image [h, w, 3] in 0..1 for the contact sheet, its caption and its text alternative."""

    image: np.ndarray
    caption: str
    alt: str

    def small(self) -> "Picture":
        """Downscale to the largest size a page shows, so that memory does not depend on the photos' size."""
        return Picture(downscaled(self.image, ENCODINGS[0][0]).astype(np.float32), self.caption, self.alt)


@dataclass(frozen=True)
class Encoded:
    """A picture as a data URI, with its size in pixels."""

    uri: str
    width: int
    height: int
    caption: str
    alt: str


@dataclass(frozen=True)
class SheetRow:
    """One view on the contact sheet."""

    heading: str
    pictures: Sequence[Encoded]

    @property
    def max_width_rem(self) -> int:
        """Widest the row may become before an image exceeds MAX_HEIGHT_REM."""
        aspect = max((picture.width / picture.height for picture in self.pictures), default=1.0)
        return round(len(self.pictures) * MAX_HEIGHT_REM * aspect)


@dataclass(frozen=True)
class Pictures:
    """All images of a page. depth_range: the depths at the ends of the depth colors, in scene units."""

    sheet: Sequence[SheetRow]
    style_image: Encoded | None = None
    depth_range: tuple[float, float] | None = None
    charts: Sequence[Chart] = field(default_factory=list)


def displayable(image: np.ndarray) -> np.ndarray:
    """Clip to 0..1; pixels with NaN or infinite values become magenta."""
    bad = ~np.isfinite(image).all(axis=-1)
    return np.where(bad[..., None], NOT_FINITE, np.clip(np.nan_to_num(image), 0, 1))


def error_picture(render: np.ndarray, photo: np.ndarray) -> np.ndarray:
    """Mean absolute difference over RGB of two images [h, w, 3], color-mapped from 0 to MAX_ERROR."""
    error = np.abs(np.nan_to_num(render) - photo).mean(axis=-1)
    colored = colormaps[ERROR_COLORS](np.clip(error / MAX_ERROR, 0, 1))[..., :3]
    return np.where(np.isfinite(render).all(axis=-1)[..., None], colored, NOT_FINITE)


def depth_picture(z: np.ndarray, alpha: np.ndarray, near: float, far: float) -> np.ndarray:
    """Color-map planar depth [h, w] linearly in 1/z, near bright, far dark; gray where alpha <= 0.5."""
    opaque = alpha > 0.5
    finite = np.isfinite(z) & (z > 0)
    inverse = 1 / np.where(finite, z, near)
    place = (1 / near - inverse) / max(1 / near - 1 / far, 1e-12)
    colored = colormaps[DEPTH_COLORS](np.clip(place, 0, 1))[..., :3]
    colored = np.where(opaque[..., None], colored, EMPTY)
    return np.where((opaque & ~finite)[..., None], NOT_FINITE, colored)


def depth_range(depths: Sequence[np.ndarray], alphas: Sequence[np.ndarray]) -> tuple[float, float]:
    """2nd and 98th percentile of the depth of opaque pixels over all views; (1, 2) if there are none."""
    kept = [z[(alpha > 0.5) & np.isfinite(z) & (z > 0)] for z, alpha in zip(depths, alphas, strict=True)]
    joined = np.concatenate(kept) if kept else np.zeros(0)
    if joined.size == 0:
        return 1.0, 2.0
    near, far = np.percentile(joined, [2, 98])
    return float(near), float(max(far, near * 1.001))


def css_gradient(name: str, steps: int = 9) -> str:
    """A color map as a CSS gradient, low end left."""
    stops = colormaps[name](np.linspace(0, 1, steps))[:, :3]
    colors = ",".join("#" + "".join(f"{round(float(part) * 255):02x}" for part in stop) for stop in stops)
    return f"linear-gradient(to right,{colors})"


def encode(pictures: Sequence[Picture], budget_bytes: int) -> list[Encoded]:
    """Encode as JPEG data URIs, at the best of ENCODINGS whose total fits the budget, else at the last."""
    encoded: list[Encoded] = []
    for width, quality in ENCODINGS:
        encoded = [encoded_picture(picture, width, quality) for picture in pictures]
        if sum(len(item.uri) for item in encoded) <= budget_bytes:
            break
    return encoded


def downscaled(image: np.ndarray, width: int) -> np.ndarray:
    """Downscale an image [h, w, 3] to `width` pixels if it is wider."""
    if image.shape[1] <= width:
        return image
    height = max(1, round(image.shape[0] * width / image.shape[1]))
    return resize(image, (height, width), anti_aliasing=True)


def encoded_picture(picture: Picture, width: int, quality: int, subsampling: int = -1) -> Encoded:
    """Encode a picture, downscaled to `width` pixels if it is wider, as a JPEG data URI without metadata.

    Args:
        picture: What to encode.
        width: Pixels at most.
        quality: Of JPEG, 1 to 95.
        subsampling: Of chroma: 0 for none, -1 for the encoder's own.
    """
    image = downscaled(picture.image, width)
    pixels = np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)
    buffer = io.BytesIO()
    imsave(buffer, pixels, format="jpeg", pil_kwargs={"quality": quality, "optimize": True, "subsampling": subsampling})
    uri = "data:image/jpeg;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")
    return Encoded(uri, pixels.shape[1], pixels.shape[0], picture.caption, picture.alt)


PICTURES_BYTES = 3_500_000  # characters of data URIs: with charts and tables the page stays under 5 MB


def chosen_views(rows: Sequence[Row], key: str, limit: int) -> list[tuple[int, str]]:
    """Choose at most `limit` views: those with remarks, the worst, the best, and others evenly spread.

    Args:
        key: the metric that ranks views, higher is better; without values of it, views are only spread.

    Returns:
        Indices of rows in order, each with a word for the heading ("worst", "best", "see the remark" or "").
    """
    chosen: dict[int, str] = {}
    for i, row in enumerate(rows):
        if row.get("remark") and len(chosen) < max(1, limit // 2):
            chosen[i] = "see the remark"
    values = [(number_in(row, key), i) for i, row in enumerate(rows)]
    ranked = [i for _, i in sorted((value, i) for value, i in values if value is not None)]
    if len(ranked) > 1:
        chosen.setdefault(ranked[0], "worst")
        chosen.setdefault(ranked[-1], "best")
    for place in np.linspace(0, len(rows) - 1, limit).round().astype(int):
        if len(chosen) >= limit:
            break
        chosen.setdefault(int(place), "")
    return sorted(chosen.items())[: max(limit, 0)]


class ContactSheet:
    """Collect the thumbnails of views, then encode them together within PICTURES_BYTES."""

    def __init__(self, style_image: Picture | None, stylized: bool, edited: bool = False) -> None:
        self._make = _edited_pictures if edited else _stylized_pictures if stylized else _fit_pictures
        self._style_image = style_image
        self._views: list[_View] = []

    def add(
        self,
        heading: str,
        row: Row,
        render: Render,
        photo: Photo | None,
        base: Render | None = None,
        painted: np.ndarray | None = None,
    ) -> None:
        """Add a view.

        Args:
            base: The unstylized (for a local edit, the unedited) render of the same view.
            painted: Its photo painted in 2D, [h, w, 3]; then the row is photo, style image, this, render.
        """
        found = self._make(row, render, photo, base)
        if painted is not None and photo is not None and self._style_image is not None:
            alt = f"The photo of view {render.name}, stylized in 2D"
            found = [_photo(render, photo), self._style_image, Picture(painted, "painted in 2D", alt), found[-1]]
        pictures = [picture.small() for picture in found]
        # Nearest neighbors: averaged depths would lie between surfaces.
        height, width = render.z.shape
        scale = min(1.0, ENCODINGS[0][0] / width)
        nearest = np.ix_(*(np.linspace(0, side - 1, max(1, round(side * scale))).round().astype(int)
                         for side in (height, width)))  # fmt: skip
        shows_depth = painted is None
        self._views.append(
            _View(heading, render.name, pictures, render.z[nearest], render.alpha[nearest], shows_depth)
        )

    def encoded(self) -> Pictures:
        """One row per view: photo, render, error, depth.

        Stylized: photo, unstylized render, stylized render, depth; beside views painted in 2D: photo, style image,
        painted photo, stylized render. Local edit: photo, unedited render, edited render,
        their difference, depth.
        """
        near, far = depth_range([view.z for view in self._views], [view.alpha for view in self._views])
        groups = [
            [*view.pictures, *([_depth(view, near, far)] if view.shows_depth else [])] for view in self._views
        ]
        flat = [picture for group in groups for picture in group]
        if self._style_image is not None:
            flat.append(self._style_image)
        done = encode(flat, PICTURES_BYTES)
        style_image = done.pop() if self._style_image is not None else None
        rows, at = [], 0
        for view, group in zip(self._views, groups, strict=True):
            rows.append(SheetRow(view.heading, done[at : at + len(group)]))
            at += len(group)
        return Pictures(sheet=rows, style_image=style_image, depth_range=(near, far))


@dataclass(frozen=True, eq=False)
class _View:
    """Thumbnails of a view; depth and alpha wait until the depth range of all views is known."""

    heading: str
    name: str
    pictures: list[Picture]
    z: np.ndarray
    alpha: np.ndarray
    shows_depth: bool = True


def _fit_pictures(row: Row, render: Render, photo: Photo | None, _: Render | None) -> list[Picture]:
    psnr = f"{number(row['psnr'], 2)} dB" if is_number(row.get("psnr")) else "not measured"
    pictures = [Picture(displayable(render.image), f"render, {psnr}", f"Render of view {render.name}, PSNR {psnr}")]
    if photo is None:
        return pictures
    error = error_picture(render.image, photo.filled_from(render.image))
    alt = f"Absolute difference between photo and render of view {render.name}; bright is large"
    return [_photo(render, photo), *pictures, Picture(error, "error", alt)]


def _stylized_pictures(row: Row, render: Render, photo: Photo | None, base: Render | None) -> list[Picture]:
    pictures = [] if photo is None else [_photo(render, photo)]
    if base is not None:
        pictures.append(Picture(displayable(base.image), "fit", f"Unstylized render of view {base.name}"))
    ssim = row.get("content_ssim")
    score = f", content SSIM {number(ssim, 3)}" if is_number(ssim) else ""
    alt = f"Stylized render of view {render.name}{score}"
    return [*pictures, Picture(displayable(render.image), f"stylized{score}", alt)]


def _edited_pictures(row: Row, render: Render, photo: Photo | None, base: Render | None) -> list[Picture]:
    pictures = [] if photo is None else [_photo(render, photo)]
    edited = Picture(displayable(render.image), "edited", f"Render of view {render.name} after the edit")
    if base is None or base.image.shape != render.image.shape:
        return [*pictures, edited]
    change = error_picture(render.image, np.nan_to_num(base.image))
    alt = f"Absolute difference between the renders of view {render.name} before and after the edit; bright is large"
    before = Picture(displayable(base.image), "unedited", f"Render of view {render.name} before the edit")
    return [*pictures, before, edited, Picture(change, "change", alt)]


def _photo(render: Render, photo: Photo) -> Picture:
    return Picture(photo.image, "photo", f"Photo of view {render.name}")


def _depth(view: _View, near: float, far: float) -> Picture:
    alt = f"Depth of view {view.name}; near is bright, far is dark, gray is transparent"
    return Picture(depth_picture(view.z, view.alpha, near, far), "depth", alt)
