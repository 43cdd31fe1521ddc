"""What a step of a fit does, by the used fraction of the budget."""

import numpy as np

from stylerf.training.common.adam import SMOOTH_EVERY
from stylerf.training.fit.engine import Batch
from stylerf.training.fit.settings import FitSettings, FitState

# Of the budget:
EXPOSURE_FROM = 0.1  # before, a field is brighter or darker than its photos for other reasons
SEEN_FROM = 0.2  # from here on, cells that no ray sees anything in for long are emptied
DISTORTION_FROM, DISTORTION_FULL = 0.2, 0.6
OPACITY_FROM = 0.25
USABLE_FROM = 0.5  # from here on the best field so far is worth more than an error


def batch_at(progress: float, state: FitState, settings: FitSettings, among: int, channels: int) -> Batch:
    """Return the next step.

    Args:
        among: views that rays are drawn from, the first ones.
        channels: of the photos.
    """
    # Every SMOOTH_EVERY-th step with that many times the weight: the same pull on average (decision 0011).
    smoothing = SMOOTH_EVERY if state.step % SMOOTH_EVERY == 0 else 0
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
        distortion=settings.distortion * _rise(progress, DISTORTION_FROM, DISTORTION_FULL),
        least_weight=settings.least_weight if progress >= SEEN_FROM else 0.0,
        earlier=state.drawn,
    )


def rays_for(samples: int, samples_per_ray: float, before: int, most: int) -> int:
    """Return the rays of the next step, for about `samples` samples in all; changes slowly, between 256 and `most`."""
    # The count per ray falls as empty space is found; smoothed, so that one odd batch does not swing the next.
    wanted = samples / max(samples_per_ray, 1.0)
    return int(np.clip(0.8 * before + 0.2 * wanted, 256, most))


def refresh_every(step: int) -> int:
    """Return the steps between updates of the occupancy grid.

    Often while the density changes fast and each update makes steps cheaper, seldom once it is stable.
    """
    return 8 if step < 64 else 16 if step < 300 else 64


def _rise(progress: float, begin: float, end: float) -> float:
    """0 before `begin`, 1 after `end`, linear between."""
    return min(1.0, max(0.0, (progress - begin) / (end - begin)))
