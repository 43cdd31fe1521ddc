"""What counts as success, by numbers stated beforehand: one criterion for fits, for stylizations, for local edits.

    fit           every value is finite, and the test views are at least LEAST_GAIN dB nearer to their photos than the
                  best picture of one color is; of an object, than its own outlines filled with one color are
    stylization   every value is finite; of the local variance of the photos' luma the test views' luma explains at
                  least LEAST_STRUCTURE, of an object of what its outlines in one color leave; and their colors are at
                  most COLOR_SHARE as far from the painting's as the photos' are, or at most COLOR_NEAR from them
                  (2-Wasserstein distance of colors as Gaussians)
    edit          every value is finite; some test view shows the part; its colors change by at least LEAST_CHANGE in
                  the mean (CIE76); what is around it, MARGIN pixels apart, by at most MOST_SPILL of that; and its luma
                  keeps at least LEAST_CONTENT of SSIM with the field before

Strokes are not asked for: a network that judges them would be judged by itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from stylerf.metrics.image_quality import content_ssim, explained_structure, psnr
from stylerf.metrics.local_edit import mean_change, split_view
from stylerf.metrics.palette_distance import palette_distance

LEAST_GAIN = 3.0  # dB
LEAST_CONTENT = 0.2
LEAST_STRUCTURE = 1 / 3  # a flat picture has 0, the photo 1; chosen by looking, docs/decisions/0037
# Sound stylizations of 15 steps were seen at shares of 0.38 to 0.52, by painting; what is not stylized is at 1.
COLOR_SHARE, COLOR_NEAR = 0.7, 0.1
LEAST_CHANGE, MOST_SPILL, MARGIN = 10.0, 0.2, 3
SCORES = {
    "fits": ("PSNR", "dB", 2),
    "stylizations": ("structure kept", "", 3),
    "edits": ("change that stays inside", "", 3),
}
REVISION = 4  # of these criteria: a run that was judged by others is run again


@dataclass(frozen=True, eq=False)
class Seen:
    """A test view: render and photo [h, w, 3] sRGB 0..1 over one background; mask [h, w] of what is there, or None.

    Of a local edit: `photo` is the render before it, `mask` what shows the edited part.
    """

    name: str
    render: np.ndarray
    photo: np.ndarray
    mask: np.ndarray | None = None


@dataclass(frozen=True)
class Verdict:
    """why: in words, where it failed. score: what SCORES names; None where nothing was made or all is NaN.

    worst: place of the view with the lowest score of its own.
    """

    ok: bool
    why: str
    score: float | None
    worst: int
    figures: dict[str, float] = field(default_factory=dict)


def judged_fit(views: Sequence[Seen]) -> Verdict:
    """By PSNR, mean over the views, beside that of flat pictures: see the module's text.

    On a plain ground any blob beats a picture of the ground's color; an object's outlines must be beaten instead.
    """
    if (broken := _not_finite(views)) is not None:
        return broken
    each = [min(psnr(view.render, view.photo), 100.0) for view in views]
    flat = _colors(views, "photo").mean(0)
    least = float(np.mean([min(psnr(_filled(view, flat), view.photo), 100.0) for view in views]))
    score = float(np.mean(each))
    gain = score - least
    told = "its outlines in one color" if any(view.mask is not None for view in views) else "one flat color"
    why = "" if gain >= LEAST_GAIN else f"{gain:.1f} dB over {told}, {LEAST_GAIN:g} are asked for"
    return Verdict(not why, why, score, int(np.argmin(each)), {"psnr": score, "gain_over_flat": gain})


def _filled(view: Seen, color: np.ndarray) -> np.ndarray:
    """`color`, one or [h, w, 3]; of an object, in what its mask shows alone: the rest is the photo's."""
    inside = np.ones(view.photo.shape[:2], bool) if view.mask is None else view.mask
    return np.where(inside[..., None], color, view.photo)


def judged_style(views: Sequence[Seen], painting: np.ndarray) -> Verdict:
    """Score: structure kept, mean over the views. painting: [h, w, 3] sRGB 0..1.

    Of an object, what the photos' masks show counts alone.
    """
    if (broken := _not_finite(views)) is not None:
        return broken
    content, each = (np.array(found) for found in zip(*map(_content_and_structure, views), strict=True))
    wanted = painting.reshape(-1, 3)
    before = palette_distance(_colors(views, "photo"), wanted).frechet
    after = palette_distance(_colors(views, "render"), wanted).frechet
    score = float(np.mean(each))
    whys = []
    if score < LEAST_STRUCTURE:
        whys.append(f"structure kept {score:.2f}, {LEAST_STRUCTURE:g} is asked for")
    if after > max(COLOR_SHARE * before, COLOR_NEAR):
        whys.append(f"colors {after:.2f} from the painting's, the photos {before:.2f}")
    figures = {"structure": score, "content_ssim": float(content.mean())}
    figures |= {"color_distance": after, "color_distance_of_photos": before}
    return Verdict(not whys, "; ".join(whys), score, int(np.argmin(each)), figures)


def _content_and_structure(view: Seen) -> tuple[float, float]:
    """SSIM of luma with the photo; and the structure that it shares with it, 0 of a flat picture, 1 of the photo.

    Flat: of an object its outlines, filled with its own mean color, for they are the photo's here.
    """
    filled, flat = _filled(view, view.render), _filled(view, _colors([view], "render").mean(0))
    kept, least = (explained_structure(picture, view.photo, _weights(view)) for picture in (filled, flat))
    return content_ssim(filled, view.photo, _weights(view)), (kept - least) / max(1 - least, 1e-6)


def judged_edit(views: Sequence[Seen]) -> Verdict:
    """Score: 1 - (mean change around the part) / (mean change of it), at least 0."""
    if (broken := _not_finite(views)) is not None:
        return broken
    shown = [view for view in views if view.mask.any()]
    if not shown:
        return Verdict(False, "no test view shows the part", None, 0)
    parts = [split_view(view.mask, MARGIN, 0) for view in shown]
    inside = _change(shown, [part.inside for part in parts])
    around = _change(shown, [part.outside for part in parts])
    content = float(np.mean([content_ssim(view.render, view.photo, _weights(view)) for view in shown]))
    whys = []
    if inside < LEAST_CHANGE:
        whys.append(f"the part changed by {inside:.1f} dE, {LEAST_CHANGE:g} are asked for")
    if around > MOST_SPILL * inside:
        whys.append(f"what is around it changed by {around:.1f} dE, the part by {inside:.1f}")
    if content < LEAST_CONTENT:
        whys.append(f"content SSIM {content:.2f}, {LEAST_CONTENT:g} is asked for")
    score = max(0.0, 1 - around / inside) if inside > 0 else 0.0
    spilt = [_change([view], [part.outside]) for view, part in zip(shown, parts, strict=True)]
    figures = {"change_inside": inside, "change_around": around, "content_ssim": content}
    return Verdict(not whys, "; ".join(whys), score, views.index(shown[int(np.argmax(spilt))]), figures)


def _change(views: Sequence[Seen], masks: Sequence[np.ndarray]) -> float:
    """Mean CIE76 difference between render and photo over the pixels of all masks; 0 where there are none."""
    renders, photos = (
        np.concatenate([getattr(view, what)[mask] for view, mask in zip(views, masks, strict=True)])[None]
        for what in ("render", "photo")
    )
    found = mean_change(renders, photos, np.ones(renders.shape[:2], bool))
    return 0.0 if found is None else found.lab


def _not_finite(views: Sequence[Seen]) -> Verdict | None:
    bad = [i for i, view in enumerate(views) if not np.isfinite(view.render).all()]
    if not bad:
        return None
    return Verdict(False, f"values that are not finite in {len(bad)} of {len(views)} views", None, bad[0])


def _weights(view: Seen) -> np.ndarray | None:
    return view.mask if view.mask is not None and view.mask[5:-5, 5:-5].any() else None


def _colors(views: Sequence[Seen], what: str) -> np.ndarray:
    parts = []
    for view in views:
        picture = getattr(view, what)
        parts.append(picture[view.mask] if view.mask is not None and view.mask.any() else picture.reshape(-1, 3))
    return np.concatenate(parts)
