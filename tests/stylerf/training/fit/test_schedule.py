"""What each step of a fit takes, by the spent fraction of the budget."""

import pytest

from stylerf.training.fit.schedule import batch_at
from stylerf.training.fit.settings import FitSettings, FitState


def weights(progress: float, **options) -> tuple[float, float]:
    batch = batch_at(progress, FitState(), FitSettings(distortion=0.01, least_weight=0.02, **options), 4, 3)
    return batch.distortion, batch.least_weight


def test_haze_is_cleared_once_colors_have_formed():
    assert [weights(at) for at in (0.0, 0.19)] == [(0, 0)] * 2
    assert weights(0.4) == (pytest.approx(0.005), 0.02)
    assert [weights(at) for at in (0.6, 0.8, 1.0)] == [(0.01, 0.02)] * 3


def test_an_overshoot_is_over_before_the_end():
    assert weights(0.4, overshoot=(2.0, 2.0)) == (pytest.approx(0.01), 0.04)
    assert weights(0.5, overshoot=(2.0, 2.0)) == (pytest.approx(0.015), 0.04)
    assert weights(0.6, overshoot=(2.0, 2.0)) == (pytest.approx(0.015), pytest.approx(0.03))
    assert [weights(at, overshoot=(2.0, 2.0)) for at in (0.7, 1.0)] == [(0.01, 0.02)] * 2


def test_each_weight_has_its_own_overshoot():
    assert weights(0.5, overshoot=(2.0, 1.0)) == (pytest.approx(0.015), 0.02)
    assert weights(0.5, overshoot=(1.0, 3.0)) == (pytest.approx(0.0075), pytest.approx(0.06))
