"""Which views go on the contact sheet, and the pictures of each."""

from collections.abc import Sequence

import numpy as np

from stages.evaluation.figures import Row, is_number
from stages.evaluation.page import Pictures, SheetRow
from stages.evaluation.pictures import Picture, depth_picture, depth_range, encode, error_picture, shown
from stages.evaluation.views import Photo, Render
from stages.evaluation.wording import number

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


class Sheet:
    """Gathers views and encodes all their pictures at once, so that the whole fits its budget."""

    def __init__(self, painting: np.ndarray | None, painting_name: str, edited: bool = False) -> None:
        self._edited = edited
        self._painting = painting
        self._painting_name = painting_name
        self._views: list[tuple[str, Row, Render, Photo | None, Render | None]] = []

    def add(self, heading: str, row: Row, render: Render, photo: Photo | None, base: Render | None = None) -> None:
        """One view; `base` is the unstylised (of a local edit the unedited) render of the same view."""
        self._views.append((heading, row, render, photo, base))

    def encoded(self, stylised: bool) -> Pictures:
        """Rows ready for the page: photo, render, error, depth; or photo, unstylised render, stylised render, depth.

        Of a local edit: photo, unedited render, edited render, what differs between the two, depth.
        """
        renders = [view[2] for view in self._views]
        near, far = depth_range([render.z for render in renders], [render.alpha for render in renders])
        groups = []
        for _, row, render, photo, base in self._views:
            make = _edited_pictures if self._edited else _stylised_pictures if stylised else _fit_pictures
            groups.append([*make(row, render, photo, base), _depth(render, near, far)])
        flat = [picture for group in groups for picture in group]
        if self._painting is not None:
            flat.append(Picture(self._painting, "the painting", f"The painting {self._painting_name}"))
        done = encode(flat, PICTURES_BYTES)
        painting = done.pop() if self._painting is not None else None
        rows, at = [], 0
        for (heading, *_), group in zip(self._views, groups, strict=True):
            rows.append(SheetRow(heading, done[at : at + len(group)]))
            at += len(group)
        return Pictures(sheet=rows, painting=painting, depth_range=(near, far))


def _fit_pictures(row: Row, render: Render, photo: Photo | None, _: Render | None) -> list[Picture]:
    told = f"{number(row['psnr'], 2)} dB" if is_number(row.get("psnr")) else "not measured"
    pictures = [Picture(shown(render.image), f"render, {told}", f"Render of view {render.name}, PSNR {told}")]
    if photo is None:
        return pictures
    error = error_picture(render.image, photo.beside(render.image))
    where = f"Absolute difference between photo and render of view {render.name}; bright is large"
    return [_photo(render, photo), *pictures, Picture(error, "error", where)]


def _stylised_pictures(row: Row, render: Render, photo: Photo | None, base: Render | None) -> list[Picture]:
    pictures = [] if photo is None else [_photo(render, photo)]
    if base is not None:
        pictures.append(Picture(shown(base.image), "fit", f"Unstylised render of view {base.name}"))
    ssim = row.get("content_ssim")
    told = f", content SSIM {number(ssim, 3)}" if is_number(ssim) else ""
    return [*pictures, Picture(shown(render.image), f"stylised{told}", f"Stylised render of view {render.name}{told}")]


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


def _depth(render: Render, near: float, far: float) -> Picture:
    what = f"Depth of view {render.name}; near is bright, far is dark, grey is nothing"
    return Picture(depth_picture(render.z, render.alpha, near, far), "depth", what)
