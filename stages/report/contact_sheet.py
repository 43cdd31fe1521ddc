"""Which views go on the contact sheet, and the pictures of each."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stages.evaluation.metrics import Row, is_number
from stages.evaluation.test_views import Photo, Render
from stages.report.evaluation_page import Pictures, SheetRow
from stages.report.formatting import number
from stages.report.thumbnails import LADDER, Picture, depth_picture, depth_range, encode, error_picture, shown

PICTURES_BYTES = 3_500_000  # characters of data URIs: with charts and tables the page stays under 5 MB


def chosen_views(rows: Sequence[Row], key: str, most: int) -> list[tuple[int, str]]:
    """At most `most` indices of rows in order, each with a word: views not finite, the worst, the best, others spread.

    key: the figure by which worst and best are told (higher is better); where no row has it, views are only spread.
    """
    chosen: dict[int, str] = {}
    for i, row in enumerate(rows):
        if row.get("remark") and len(chosen) < max(1, most // 2):
            chosen[i] = "see the remark"
    ranked = sorted((i for i, row in enumerate(rows) if is_number(row.get(key))), key=lambda i: rows[i][key])
    if len(ranked) > 1:
        chosen.setdefault(ranked[0], "worst")
        chosen.setdefault(ranked[-1], "best")
    for place in np.linspace(0, len(rows) - 1, most).round().astype(int):
        if len(chosen) >= most:
            break
        chosen.setdefault(int(place), "")
    return sorted(chosen.items())[: max(most, 0)]


class ContactSheet:
    """Gathers views, each as small as the page shows it, and encodes all at once, so that the whole fits its budget."""

    def __init__(self, painting: Picture | None, stylized: bool, edited: bool = False) -> None:
        self._make = _edited_pictures if edited else _stylized_pictures if stylized else _fit_pictures
        self._painting = painting
        self._views: list[_View] = []

    def add(self, heading: str, row: Row, render: Render, photo: Photo | None, base: Render | None = None) -> None:
        """One view; `base` is the unstylized (of a local edit the unedited) render of the same view."""
        pictures = [picture.small() for picture in self._make(row, render, photo, base)]
        # Depths cannot be averaged: of every so many pixels one is taken.
        height, width = render.z.shape
        part = min(1.0, LADDER[0][0] / width)
        taken = np.ix_(*(np.linspace(0, side - 1, max(1, round(side * part))).round().astype(int)
                         for side in (height, width)))  # fmt: skip
        self._views.append(_View(heading, render.name, pictures, render.z[taken], render.alpha[taken]))

    def encoded(self) -> Pictures:
        """Rows ready for the page: photo, render, error, depth; or photo, unstylized render, stylized render, depth.

        Of a local edit: photo, unedited render, edited render, what differs between the two, depth.
        """
        near, far = depth_range([view.z for view in self._views], [view.alpha for view in self._views])
        groups = [[*view.pictures, _depth(view, near, far)] for view in self._views]
        flat = [picture for group in groups for picture in group]
        if self._painting is not None:
            flat.append(self._painting)
        done = encode(flat, PICTURES_BYTES)
        painting = done.pop() if self._painting is not None else None
        rows, at = [], 0
        for view, group in zip(self._views, groups, strict=True):
            rows.append(SheetRow(view.heading, done[at : at + len(group)]))
            at += len(group)
        return Pictures(sheet=rows, painting=painting, depth_range=(near, far))


@dataclass(frozen=True, eq=False)
class _View:
    """What is kept of a view: pictures, and depth and alpha for one whose colors all views settle."""

    heading: str
    name: str
    pictures: list[Picture]
    z: np.ndarray
    alpha: np.ndarray


def _fit_pictures(row: Row, render: Render, photo: Photo | None, _: Render | None) -> list[Picture]:
    told = f"{number(row['psnr'], 2)} dB" if is_number(row.get("psnr")) else "not measured"
    pictures = [Picture(shown(render.image), f"render, {told}", f"Render of view {render.name}, PSNR {told}")]
    if photo is None:
        return pictures
    error = error_picture(render.image, photo.beside(render.image))
    where = f"Absolute difference between photo and render of view {render.name}; bright is large"
    return [_photo(render, photo), *pictures, Picture(error, "error", where)]


def _stylized_pictures(row: Row, render: Render, photo: Photo | None, base: Render | None) -> list[Picture]:
    pictures = [] if photo is None else [_photo(render, photo)]
    if base is not None:
        pictures.append(Picture(shown(base.image), "fit", f"Unstylized render of view {base.name}"))
    ssim = row.get("content_ssim")
    told = f", content SSIM {number(ssim, 3)}" if is_number(ssim) else ""
    return [*pictures, Picture(shown(render.image), f"stylized{told}", f"Stylized render of view {render.name}{told}")]


def _edited_pictures(row: Row, render: Render, photo: Photo | None, base: Render | None) -> list[Picture]:
    pictures = [] if photo is None else [_photo(render, photo)]
    edited = Picture(shown(render.image), "edited", f"Render of view {render.name} after the edit")
    if base is None or base.image.shape != render.image.shape:
        return [*pictures, edited]
    change = error_picture(render.image, np.nan_to_num(base.image))
    where = f"Absolute difference between the renders of view {render.name} before and after the edit; bright is large"
    before = Picture(shown(base.image), "unedited", f"Render of view {render.name} before the edit")
    return [*pictures, before, edited, Picture(change, "change", where)]


def _photo(render: Render, photo: Photo) -> Picture:
    return Picture(photo.image, "photo", f"Photo of view {render.name}")


def _depth(view: _View, near: float, far: float) -> Picture:
    what = f"Depth of view {view.name}; near is bright, far is dark, gray is nothing"
    return Picture(depth_picture(view.z, view.alpha, near, far), "depth", what)
