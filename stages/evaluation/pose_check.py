"""Check a scene's poses by how far its photos are shifted from the renders of a fitted field (decision 0045)."""

import math
from dataclasses import dataclass

import numpy as np

from stages.artifacts.scene import spread
from stylerf.geometry.resampling import shrunk
from stylerf.metrics.image_quality import shift_between
from stylerf.training.common.ray_dataset import HIDDEN, STRETCH, background_of, over, target
from stylerf.training.fit.fitter import Fitter

EVEN_VIEWS, WORST_VIEWS = 8, 3  # checked: views evenly spread, and those with the largest error
LONGER_SIDE = 128  # pixels of the images that are compared
RAYS, MIN_RAYS_PER_VIEW = 16_384, 64  # sampled to find the worst views
MIN_CORRELATION = 0.5  # below this, render and photo are too different to measure a shift
# With correct poses, the median shift is below BASE_SHIFT + SHIFT_SLOPE (1 - its correlation), as a fraction of the
# longer side: an unfinished field locates things less precisely. Shifts up to MIN_SHIFT_PX never warn.
BASE_SHIFT, SHIFT_SLOPE, MIN_SHIFT_PX = 0.001, 0.03, 1.0
# A view below the first is an outlier if the median correlation is above the second.
OUTLIER_CORRELATION, GOOD_CORRELATION = 0.6, 0.85
ADVICE = (
    "find new poses with `stylerf import PHOTOS WORK --format photos`, also with --matching exhaustive or more "
    "--sfm-features"
)


@dataclass(frozen=True)
class ViewShift:
    """The shift between a view's photo and its render.

    Attributes:
        pixels: in pixels of the photo.
        fraction: of the photo's longer side.
        correlation: of photo and render after removing the shift, -1..1.
        evenly: whether the view is one of those evenly spread.
    """

    name: str
    pixels: float
    fraction: float
    correlation: float
    evenly: bool


def pose_shifts(fitter: Fitter) -> list[ViewShift]:
    """Measure the shifts of some views, smallest fraction first. A collective call: every process must take part."""
    cameras = fitter.dataset.cameras
    evenly = spread(list(range(len(cameras))), min(EVEN_VIEWS, len(cameras)))
    found = []
    for view in [*evenly, *(view for view in _worst_views(fitter) if view not in evenly)]:
        camera = cameras[view]
        longer = max(camera.width, camera.height)
        small = camera.scaled(min(1.0, LONGER_SIDE / longer))
        (right, down), correlation = shift_between(*_photo_and_render(fitter, view, small))
        pixels = math.hypot(right * camera.width / small.width, down * camera.height / small.height)
        found.append(ViewShift(camera.name, pixels, pixels / longer, correlation, view in evenly))
    return sorted(found, key=lambda shift: shift.fraction)


def pose_metrics(shifts: list[ViewShift]) -> dict:
    """Shifts for the manifest: pixels of the median and the worst view, median correlation, and both of each view."""
    median, worst = _median(shifts), shifts[-1]
    return {
        "median": round(median.pixels, 2),
        "worst": round(worst.pixels, 2),
        "worst_view": worst.name,
        "correlation": round(_correlation(shifts), 3),
        "views": {shift.name: [round(shift.pixels, 2), round(shift.correlation, 3)] for shift in shifts},
    }


def pose_warning(shifts: list[ViewShift]) -> str | None:
    """Return a warning if poses do not match the photos; None if they do, or if the field is too poor to decide."""
    median, worst, correlation = _median(shifts), shifts[-1], _correlation(shifts)
    count = sum(shift.evenly for shift in shifts)
    if correlation < MIN_CORRELATION:
        return None
    if median.fraction > BASE_SHIFT + SHIFT_SLOPE * (1 - correlation) and median.pixels > MIN_SHIFT_PX:
        return (
            f"poses: the median shift between photos and renders of {count} views is {median.pixels:.1f} px (worst: "
            f"{worst.name}, {worst.pixels:.0f} px); the poses do not match the photos: {ADVICE}, "
            "or leave the worst views out"
        )
    outlier = min(shifts, key=lambda shift: shift.correlation)
    if outlier.correlation < OUTLIER_CORRELATION and correlation > GOOD_CORRELATION:
        return (
            f"poses: {outlier.name} differs from its render (correlation {outlier.correlation:.2f}; the median of "
            f"{count} views is {correlation:.2f}); its pose is wrong, or its photo shows something else: leave it "
            "out, or " + ADVICE
        )
    return None


def _median(shifts: list[ViewShift]) -> ViewShift:
    evenly = [shift for shift in shifts if shift.evenly]
    return evenly[(len(evenly) - 1) // 2]


def _correlation(shifts: list[ViewShift]) -> float:
    return float(np.median([shift.correlation for shift in shifts if shift.evenly]))


def _worst_views(fitter: Fitter) -> list[int]:
    """The views with the largest mean squared error, over a sample of rays."""
    bank, count = fitter.dataset, len(fitter.dataset.cameras)
    rays = max(MIN_RAYS_PER_VIEW, RAYS // count)
    views = np.repeat(np.arange(count), rays)
    generator = np.random.default_rng([fitter.seed, 5])
    pixels = (generator.random(len(views)) * bank.sizes[views]).astype(np.int64)
    origins, directions, colors = bank.at(views, pixels)
    out = fitter.engine.rendered(origins, directions)
    background = background_of(fitter.settings.background, len(out), None)
    error = np.square(over(out[:, :3], out[:, 3:4], background) - target(colors, background)).mean(1)
    if fitter.field.opaque_background and bank.channels == 4:
        error[colors[:, 3] <= HIDDEN] = 0
    return np.argsort(-error.reshape(count, rays).mean(1), kind="stable")[:WORST_VIEWS].tolist()


def _photo_and_render(fitter: Fitter, view: int, camera) -> tuple[np.ndarray, np.ndarray]:
    """Photo and render of a view as gray images [h, w] at the size of `camera`, over the fit's background."""
    bank, own = fitter.dataset, fitter.dataset.cameras[view]
    count = bank.sizes[view] * bank.channels
    photo = bank.bytes[bank.starts[view] : bank.starts[view] + count].reshape(own.height, own.width, bank.channels)
    photo = photo.astype(np.float32) / 255
    bank.read(math.ceil(count / STRETCH))
    alpha = photo[..., 3:] if bank.channels == 4 else np.ones_like(photo[..., :1])
    photo = shrunk(np.concatenate([photo[..., :3] * alpha, alpha], 2), (camera.width, camera.height))
    out = fitter.engine.rendered(*camera.rays()).reshape(camera.height, camera.width, 5)
    background = background_of(fitter.settings.background, 1, None)
    shown = over(out[..., :3], out[..., 3:4], background)
    photo, hidden = over(photo[..., :3], photo[..., 3:], background), photo[..., 3:] <= HIDDEN
    if fitter.field.opaque_background and bank.channels == 4:
        photo = np.where(hidden, shown, photo)
    return photo.mean(2), shown.mean(2)
