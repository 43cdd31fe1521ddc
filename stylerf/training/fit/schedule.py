"""The schedule of a fit: each step's parameters, by the spent fraction of the budget."""

import numpy as np

from stylerf.training.common.adam import SMOOTH_EVERY
from stylerf.training.fit.engine import Batch
from stylerf.training.fit.settings import FitSettings, FitState

# Of the budget:
EXPOSURE_FROM = 0.1  # earlier, a field is brighter or darker than its photos for other reasons
EXPOSURE_KNOWN = 0.3  # from here on, exposures that do not clearly differ count as equal
SEEN_FROM = 0.2  # from here on, cells in which rays have not seen anything for a long time are emptied
DISTORTION_FROM, DISTORTION_FULL = 0.2, 0.6
OVERSHOOT_UNTIL, OVERSHOOT_GONE = 0.5, 0.7
OPACITY_FROM = 0.25
USABLE_FROM = 0.5  # from here on, end with the best field so far instead of an error


def batch_at(progress: float, state: FitState, settings: FitSettings, among: int, channels: int) -> Batch:
    """Return the next step.

    Args:
        among: number of views, from the first, that rays are drawn from.
        channels: of the photos.
    """
    # Every SMOOTH_EVERY-th step, with SMOOTH_EVERY times the weight: the same on average (decision 0011).
    smoothing = SMOOTH_EVERY if state.step % SMOOTH_EVERY == 0 else 0
    # Haze goes early: what clearing takes too much of can grow again (decision 0075).
    over = _rise(progress, OVERSHOOT_UNTIL, OVERSHOOT_GONE)
    more_distortion, more_least = (factor + (1 - factor) * over for factor in settings.overshoot)
    return Batch(
        step=state.step,
        rays=state.rays,
        parts=state.parts,
        among=among,
        lit_share=settings.lit_share,
        background=settings.background,
        # Exponential decay over the budget, halved by each rollback.
        rate=settings.rate * settings.final_rate**progress * state.rate_scale,
        smoothness=(smoothing * settings.smoothness[0], smoothing * settings.smoothness[1]),
        near_scaling_distance=settings.near_scaling_distance,
        opacity=settings.opacity * _rise(progress, OPACITY_FROM, 1.0),
        coverage=settings.coverage if channels == 4 else 0.0,
        distortion=settings.distortion * more_distortion * _rise(progress, DISTORTION_FROM, DISTORTION_FULL),
        least_weight=settings.least_weight * more_least if progress >= SEEN_FROM else 0.0,
        earlier=state.drawn,
    )


def rays_for(samples: int, samples_per_ray: float, before: int, most: int) -> int:
    """Return the number of rays of the next step, 256 to `most`, for about `samples` samples; changes slowly."""
    # Samples per ray decrease as empty space is found; smoothed, so that one unusual batch has little effect.
    wanted = samples / max(samples_per_ray, 1.0)
    return int(np.clip(0.8 * before + 0.2 * wanted, 256, most))


def refresh_every(step: int) -> int:
    """Return the number of steps between updates of the occupancy grid.

    Frequent while the density changes fast and each update makes steps cheaper, rare once it is stable.
    """
    return 8 if step < 64 else 16 if step < 300 else 64


def _rise(progress: float, begin: float, end: float) -> float:
    """Return a linear ramp: 0 before `begin`, 1 after `end`."""
    return min(1.0, max(0.0, (progress - begin) / (end - begin)))
