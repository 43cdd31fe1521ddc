"""Success criteria of fits, stylizations and local edits, fixed in advance. All values must be finite.

    fit           PSNR of the test views is at least MIN_GAIN dB above that of the best picture of one color; for an
                  object, above that of its silhouette filled with one color
    stylization   the test views' luma explains at least MIN_STRUCTURE of the local variance of the photos' luma (for
                  an object: of the part that its silhouette in one color leaves); and their colors are at most
                  COLOR_SHARE as far from the style image's as the photos' are, or at most COLOR_NEAR away
                  (2-Wasserstein distance of colors as Gaussians)
    edit          a test view shows the region; its colors change by at least MIN_CHANGE on average (CIE76), those
                  more than MARGIN pixels around it by at most MOST_SPILL of that; and its luma keeps an SSIM of at
                  least MIN_CONTENT with the field before

Strokes are not judged: the network that judges them would be the one that was optimized.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from stylerf.metrics.frechet import palette_distance
from stylerf.metrics.image_quality import content_ssim, explained_structure, psnr
from stylerf.metrics.local_edit import mean_change, split_view

MIN_GAIN = 3.0  # dB
MIN_CONTENT = 0.2
MIN_STRUCTURE = 1 / 3  # a flat picture has 0, the photo 1; chosen by eye, docs/decisions/0037
# Good stylizations of 15 steps had 0.38 to 0.52, depending on the style image; an unstylized scene has 1.
COLOR_SHARE, COLOR_NEAR = 0.7, 0.1
MIN_CHANGE, MOST_SPILL, MARGIN = 10.0, 0.2, 3
SCORES = {
    "fits": ("PSNR", "dB", 2),
    "stylizations": ("structure kept", "", 3),
    "edits": ("change that stays inside", "", 3),
}
REVISION = 4  # version of these criteria; runs judged by older ones are repeated


@dataclass(frozen=True, eq=False)
class ViewPair:
    """Render and photo of a test view, [h, w, 3] sRGB 0..1 over one background; mask [h, w] of the object, or None.

    For a local edit, `photo` is the render before the edit and `mask` shows the edited region.
    """

    name: str
    render: np.ndarray
    photo: np.ndarray
    mask: np.ndarray | None = None


@dataclass(frozen=True)
class Verdict:
    """The outcome of a criterion.

    why: reason for a failure. score: see SCORES; None if nothing was made or all is NaN. worst: index of the worst
    view.
    """

    ok: bool
    why: str
    score: float | None
    worst: int
    figures: dict[str, float] = field(default_factory=dict)


def judge_fit(views: Sequence[ViewPair]) -> Verdict:
    """Judge a fit by its mean PSNR above that of flat pictures.

    Any blob on a plain background beats a flat picture, so an object must beat its filled silhouette instead.
    """
    if (broken := _not_finite(views)) is not None:
        return broken
    each = [min(psnr(view.render, view.photo), 100.0) for view in views]
    flat = _colors(views, "photo").mean(0)
    of_flat = float(np.mean([min(psnr(_filled(view, flat), view.photo), 100.0) for view in views]))
    score = float(np.mean(each))
    gain = score - of_flat
    reference = "its silhouette in one color" if any(view.mask is not None for view in views) else "one flat color"
    why = "" if gain >= MIN_GAIN else f"{gain:.1f} dB over {reference}, expected at least {MIN_GAIN:g}"
    return Verdict(not why, why, score, int(np.argmin(each)), {"psnr": score, "gain_over_flat": gain})


def _filled(view: ViewPair, color: np.ndarray) -> np.ndarray:
    """Fill the view, or an object's mask over its photo, with `color`, [3] or [h, w, 3]."""
    inside = np.ones(view.photo.shape[:2], bool) if view.mask is None else view.mask
    return np.where(inside[..., None], color, view.photo)


def judge_style(views: Sequence[ViewPair], style: np.ndarray) -> Verdict:
    """Judge a stylization; the score is the structure kept, mean over the views.

    Args:
        views: the test views; of an object only the masked pixels count.
        style: the style image, [h, w, 3] sRGB 0..1.
    """
    if (broken := _not_finite(views)) is not None:
        return broken
    content, each = (np.array(found) for found in zip(*map(_content_and_structure, views), strict=True))
    wanted = style.reshape(-1, 3)
    before = palette_distance(_colors(views, "photo"), wanted).frechet
    after = palette_distance(_colors(views, "render"), wanted).frechet
    score = float(np.mean(each))
    whys = []
    if score < MIN_STRUCTURE:
        whys.append(f"structure kept {score:.2f}, expected at least {MIN_STRUCTURE:g}")
    if after > max(COLOR_SHARE * before, COLOR_NEAR):
        whys.append(f"colors {after:.2f} from the style image's, the photos {before:.2f}")
    figures = {"structure": score, "content_ssim": float(content.mean())}
    figures |= {"color_distance": after, "color_distance_of_photos": before}
    return Verdict(not whys, "; ".join(whys), score, int(np.argmin(each)), figures)


def _content_and_structure(view: ViewPair) -> tuple[float, float]:
    """Return the SSIM of luma with the photo, and the structure shared with it: 0 for a flat picture, 1 for the photo.

    An object's flat picture is its silhouette filled with its mean color.
    """
    filled, flat = _filled(view, view.render), _filled(view, _colors([view], "render").mean(0))
    kept, of_flat = (explained_structure(picture, view.photo, _weights(view)) for picture in (filled, flat))
    return content_ssim(filled, view.photo, _weights(view)), (kept - of_flat) / max(1 - of_flat, 1e-6)


def judge_edit(views: Sequence[ViewPair]) -> Verdict:
    """Judge a local edit; the score is 1 - (mean change around the region) / (mean change of it), at least 0."""
    if (broken := _not_finite(views)) is not None:
        return broken
    masked = [(view, view.mask) for view in views if view.mask is not None and view.mask.any()]
    if not masked:
        return Verdict(False, "no test view shows the region", None, 0)
    shown = [view for view, _ in masked]
    parts = [split_view(mask, MARGIN, 0) for _, mask in masked]
    inside = _change(shown, [part.inside for part in parts])
    around = _change(shown, [part.outside for part in parts])
    content = float(np.mean([content_ssim(view.render, view.photo, _weights(view)) for view in shown]))
    whys = []
    if inside < MIN_CHANGE:
        whys.append(f"the region changed by {inside:.1f} dE, expected at least {MIN_CHANGE:g}")
    if around > MOST_SPILL * inside:
        whys.append(f"its surroundings changed by {around:.1f} dE, the region by {inside:.1f}")
    if content < MIN_CONTENT:
        whys.append(f"content SSIM {content:.2f}, expected at least {MIN_CONTENT:g}")
    score = max(0.0, 1 - around / inside) if inside > 0 else 0.0
    spilt = [_change([view], [part.outside]) for view, part in zip(shown, parts, strict=True)]
    figures = {"change_inside": inside, "change_around": around, "content_ssim": content}
    return Verdict(not whys, "; ".join(whys), score, views.index(shown[int(np.argmax(spilt))]), figures)


def _change(views: Sequence[ViewPair], masks: Sequence[np.ndarray]) -> float:
    """Return the mean CIE76 difference between render and photo over all masked pixels, 0 without any."""
    renders, photos = (
        np.concatenate([getattr(view, what)[mask] for view, mask in zip(views, masks, strict=True)])[None]
        for what in ("render", "photo")
    )
    found = mean_change(renders, photos, np.ones(renders.shape[:2], bool))
    return 0.0 if found is None else found.lab


def _not_finite(views: Sequence[ViewPair]) -> Verdict | None:
    bad = [i for i, view in enumerate(views) if not np.isfinite(view.render).all()]
    if not bad:
        return None
    return Verdict(False, f"non-finite values in {len(bad)} of {len(views)} views", None, bad[0])


def _weights(view: ViewPair) -> np.ndarray | None:
    return view.mask if view.mask is not None and view.mask[5:-5, 5:-5].any() else None


def _colors(views: Sequence[ViewPair], what: str) -> np.ndarray:
    parts = []
    for view in views:
        picture = getattr(view, what)
        parts.append(picture[view.mask] if view.mask is not None and view.mask.any() else picture.reshape(-1, 3))
    return np.concatenate(parts)
