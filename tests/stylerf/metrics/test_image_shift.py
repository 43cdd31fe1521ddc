"""Shifts of pictures that were shifted by so much: of random waves, exactly, by the phase of each."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from stylerf.metrics.image_shift import shift_between


def waves(right: float = 0.0, down: float = 0.0, size: tuple[int, int] = (96, 128), seed: int = 0) -> np.ndarray:
    """[h, w]: forty waves of 6 to 40 pixels, moved exactly."""
    random = np.random.default_rng(seed)
    rows, columns = np.mgrid[: size[0], : size[1]].astype(float)
    out = np.zeros(size)
    for length, angle, phase in zip(random.uniform(6, 40, 40), *random.uniform(0, 2 * np.pi, (2, 40))):
        along = np.cos(angle) * (columns - right) + np.sin(angle) * (rows - down)
        out += np.sin(2 * np.pi * along / length + phase)
    return 0.5 + 0.05 * out


@pytest.mark.parametrize("moved", [(0, 0), (0.4, 0), (0, -0.7), (1.3, -2.6), (-9, 5.5), (20, -17)])
def test_a_shift_is_found_to_a_tenth_of_a_pixel(moved):
    found, alike = shift_between(waves(), waves(*moved))
    assert found == pytest.approx(moved, abs=0.1 + 0.02 * np.hypot(*moved))
    assert alike > (0.97 if np.hypot(*moved) < 1 else 0.6)


@pytest.mark.parametrize("moved", [(0, 0), (1.3, -2.6)])
@pytest.mark.parametrize("blur", [1, 3])
def test_blur_and_exposure_move_nothing(moved, blur):
    """A render of a coarse field of right poses is blurred, and not shifted."""
    found, _ = shift_between(waves(), 0.1 + 0.5 * gaussian_filter(waves(*moved), blur))
    assert found == pytest.approx(moved, abs=0.2)


def test_pictures_of_different_things_are_not_alike():
    assert max(shift_between(waves(seed=seed), waves(seed=seed + 1))[1] for seed in range(4)) < 0.5


@pytest.mark.parametrize("size", [(1, 1), (2, 3), (24, 16)])
def test_a_plain_picture_has_no_shift(size):
    found, alike = shift_between(np.full(size, 0.5), waves(size=size))
    assert found.tolist() == [0, 0] and alike == 0


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (2, 3), (3, 200)])
def test_a_picture_of_any_size_lies_on_itself(size):
    picture = np.random.default_rng(0).random(size)
    found, alike = shift_between(picture, picture)
    assert np.abs(found).max() <= 0.5 and (alike == pytest.approx(1) or size == (1, 1))
