"""Whether a scene's poses explain its photos: how far photos and a fitted field's pictures of them lie apart."""

import math
from dataclasses import dataclass

import numpy as np

from stages.artifacts.scene import spread
from stylerf.geometry.resampling import shrunk
from stylerf.metrics.image_shift import shift_between
from stylerf.training.common.pixels import STRETCH
from stylerf.training.common.ray_dataset import HIDDEN
from stylerf.training.fit.engine import background_of, over, target
from stylerf.training.fit.fitter import Fitter

VIEWS, SUSPECTS = 8, 3  # looked at: so many evenly, and so many of those that the field shows worst
LONGER_SIDE = 128  # pixels of the copies that are compared
RAYS, LEAST_RAYS = 16_384, 64  # of all views and of each, by which the worst are found
# Decision 0045. Shifts are shares of a photo's longer side.
ALIKE = 0.5  # below, field and photo have too little in common to be compared
# The median view of right poses is off by less than APART + VAGUE (1 - its correlation) of the longer side: the less a
# field shows yet, the vaguer the place of what it shows. LEAST_PIXELS of the photo are never told.
APART, VAGUE, LEAST_PIXELS = 0.001, 0.03, 1.0
ALIEN = 0.6  # a view less like its render than this does not go with the others, where those are as much as KNOWN
KNOWN = 0.85
ADVICE = (
    "find new poses with `stylerf import PHOTOS WORK --format photos`, also with --matching exhaustive or more "
    "--sfm-features"
)


@dataclass(frozen=True)
class ViewShift:
    """How far a view's photo and the field's picture of it lie apart: pixels of the photo, share of its longer side.

    alike: their correlation once shifted, -1..1. evenly: chosen as one of those spread over all views.
    """

    name: str
    pixels: float
    share: float
    alike: float
    evenly: bool


def pose_shifts(fitter: Fitter) -> list[ViewShift]:
    """Of some views of the field as it stands, the smallest share first. Every process must take part."""
    cameras = fitter.dataset.cameras
    evenly = spread(list(range(len(cameras))), min(VIEWS, len(cameras)))
    found = []
    for view in [*evenly, *(one for one in _worst(fitter) if one not in evenly)]:
        camera = cameras[view]
        longer = max(camera.width, camera.height)
        small = camera.scaled(min(1.0, LONGER_SIDE / longer))
        (right, down), alike = shift_between(*_both(fitter, view, small))
        pixels = math.hypot(right * camera.width / small.width, down * camera.height / small.height)
        found.append(ViewShift(camera.name, pixels, pixels / longer, alike, view in evenly))
    return sorted(found, key=lambda one: one.share)


def pose_figures(shifts: list[ViewShift]) -> dict:
    """For the manifest: pixels of the median and of the worst view, the median correlation, and both of each view."""
    median, worst = _middle(shifts), shifts[-1]
    return {
        "median": round(median.pixels, 2),
        "worst": round(worst.pixels, 2),
        "worst_view": worst.name,
        "correlation": round(_alike(shifts), 3),
        "views": {one.name: [round(one.pixels, 2), round(one.alike, 3)] for one in shifts},
    }


def told(shifts: list[ViewShift]) -> str | None:
    """The line for a user where poses do not explain the photos; None where they do, or where that cannot be told."""
    median, worst, alike = _middle(shifts), shifts[-1], _alike(shifts)
    count = sum(one.evenly for one in shifts)
    if alike < ALIKE:
        return None
    if median.share > APART + VAGUE * (1 - alike) and median.pixels > LEAST_PIXELS:
        return (
            f"poses: photos and renders are {median.pixels:.1f} px apart in the middle of {count} views (worst: "
            f"{worst.name} by {worst.pixels:.0f} px); the poses do not explain the photos: {ADVICE}, "
            "or leave the worst views out"
        )
    lost = min(shifts, key=lambda one: one.alike)
    if lost.alike < ALIEN and alike > KNOWN:
        return (
            f"poses: {lost.name} and its render have little in common (correlation {lost.alike:.2f}, "
            f"{alike:.2f} in the middle of {count} views); its pose does not explain the photo, or the "
            "photo shows something else: leave it out, or " + ADVICE
        )
    return None


def _middle(shifts: list[ViewShift]) -> ViewShift:
    evenly = [one for one in shifts if one.evenly]
    return evenly[(len(evenly) - 1) // 2]


def _alike(shifts: list[ViewShift]) -> float:
    return float(np.median([one.alike for one in shifts if one.evenly]))


def _worst(fitter: Fitter) -> list[int]:
    """The views that the field shows worst, by some rays of each."""
    bank, count = fitter.dataset, len(fitter.dataset.cameras)
    each = max(LEAST_RAYS, RAYS // count)
    views = np.repeat(np.arange(count), each)
    generator = np.random.default_rng([fitter.seed, 5])
    pixels = (generator.random(len(views)) * bank.sizes[views]).astype(np.int64)
    origins, directions, colors = bank.at(views, pixels)
    out = fitter.engine.rendered(origins, directions)
    background = background_of(fitter.settings.background, len(out), None)
    error = np.square(over(out[:, :3], out[:, 3:4], background) - target(colors, background)).mean(1)
    if fitter.field.opaque_background and bank.channels == 4:
        error[colors[:, 3] <= HIDDEN] = 0
    return np.argsort(-error.reshape(count, each).mean(1), kind="stable")[:SUSPECTS].tolist()


def _both(fitter: Fitter, view: int, camera) -> tuple[np.ndarray, np.ndarray]:
    """Gray photo and render [h, w] of a view at the size of `camera`, over the background of the fit."""
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
