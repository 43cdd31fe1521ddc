"""Choose the views on the contact sheet and make their thumbnails."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stages.evaluation.metrics import Row, is_number, number_in
from stages.evaluation.test_views import Photo, Render
from stages.report.evaluation_page import Pictures, SheetRow
from stages.report.pages import number
from stages.report.thumbnails import ENCODINGS, Picture, depth_picture, depth_range, displayable, encode, error_picture

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

    def add(self, heading: str, row: Row, render: Render, photo: Photo | None, base: Render | None = None) -> None:
        """Add a view; base: the unstylized (for a local edit, the unedited) render of the same view."""
        pictures = [picture.small() for picture in self._make(row, render, photo, base)]
        # Nearest neighbors: averaged depths would lie between surfaces.
        height, width = render.z.shape
        scale = min(1.0, ENCODINGS[0][0] / width)
        nearest = np.ix_(*(np.linspace(0, side - 1, max(1, round(side * scale))).round().astype(int)
                         for side in (height, width)))  # fmt: skip
        self._views.append(_View(heading, render.name, pictures, render.z[nearest], render.alpha[nearest]))

    def encoded(self) -> Pictures:
        """One row per view: photo, render, error, depth.

        Stylized: photo, unstylized render, stylized render, depth. Local edit: photo, unedited render, edited render,
        their difference, depth.
        """
        near, far = depth_range([view.z for view in self._views], [view.alpha for view in self._views])
        groups = [[*view.pictures, _depth(view, near, far)] for view in self._views]
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
