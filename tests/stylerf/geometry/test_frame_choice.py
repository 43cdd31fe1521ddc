"""Choosing frames: motion and sharpness against pictures moved and blurred by known amounts."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, rotate, shift

from stylerf.geometry.frame_choice import BLURRED, chosen_frames, motion_between, positions, sharpness


def texture(seed=0, height=144, width=192) -> np.ndarray:
    noise = gaussian_filter(np.random.default_rng(seed).normal(size=(height + 80, width + 80)), 1.5)
    return 128 + 40 * noise / noise.std()


def window(picture, dx=0.0, dy=0.0) -> np.ndarray:
    moved = shift(picture, (dy, dx), order=3, mode="nearest")[40:-40, 40:-40]
    return moved.clip(0, 255).round().astype(np.uint8)


@pytest.mark.parametrize("dx, dy", [(0, 0), (0.5, 0), (3, -4), (-12, 5), (0, 20)])
def test_motion_of_a_pan_is_its_length(dx, dy):
    still = texture()
    found = motion_between(window(still), window(still, dx, dy))
    assert found * 192 == pytest.approx(np.hypot(dx, dy), abs=0.15, rel=0.05)


def test_motion_of_a_roll_is_seen():
    still = texture()
    turned = rotate(still, 4, reshape=False, order=3, mode="nearest")
    rows, columns = np.indices((144, 192)) - np.array([71.5, 95.5])[:, None, None]
    true = np.radians(4) * np.hypot(rows, columns).mean()
    assert motion_between(window(still), window(turned)) * 192 == pytest.approx(true, rel=0.3)


def test_motion_across_a_cut_is_unknown_and_that_of_a_blank_wall_too():
    assert np.isnan(motion_between(window(texture(1)), window(texture(2))))
    blank = np.full((144, 192), 90, np.uint8)
    assert np.isnan(motion_between(blank, blank))


def test_sharpness_falls_with_blur_but_not_by_one_highlight():
    picture = texture()
    values = [sharpness(window(gaussian_filter(picture, blur))) for blur in (0.01, 1, 2, 4)]
    assert (np.diff(values) < -np.log(BLURRED) / 2).all()
    spot = window(gaussian_filter(picture, 2))
    spot[70:72, 70:72] = 255
    assert abs(sharpness(spot) - values[2]) < 0.1


def test_frames_are_even_in_motion_whatever_their_rate():
    speed = np.concatenate([[0], np.full(400, 0.0005), np.full(40, 0.005)])  # slow, then ten times as fast
    kept, blurred = chosen_frames(speed, np.full(441, 5.0), 40)
    gaps = np.diff(np.cumsum(speed)[kept])
    assert len(kept) == 40 and blurred == 0
    assert gaps.min() > 0.3 * gaps.mean() and gaps.max() < 1.7 * gaps.mean()


def test_the_sharpest_of_neighbors_is_taken():
    sharp = 5 + 0.5 * np.random.default_rng(0).normal(size=400)
    motion = np.full(400, 0.001)
    kept, _ = chosen_frames(motion, sharp, 40)
    assert sharp[kept].mean() > np.quantile(sharp, 0.8)


def test_blurred_frames_are_avoided_or_left_out():
    motion, sharp = np.full(400, 0.001), np.full(400, 5.0)
    sharp[100:104] -= 3  # part of a bin of ten frames
    sharp[200:225] -= 3  # two bins and more
    kept, blurred = chosen_frames(motion, sharp, 40)
    assert (sharp[kept] == 5).all() and blurred in (1, 2) and len(kept) == 40 - blurred


def test_a_long_blurred_stretch_is_kept_rather_than_a_gap():
    motion, sharp = np.full(400, 0.001), np.full(400, 5.0)
    sharp[200:250] -= 3
    kept, blurred = chosen_frames(motion, sharp, 40)
    assert len(kept) == 40 and blurred == 0


def test_motion_into_and_out_of_blur_counts_as_that_around():
    motion, sharp = np.full(50, 0.001), np.full(50, 5.0)
    motion[0], sharp[20:30] = 0, 2.0
    motion[[20, 30]] = 0.05
    motion[40] = np.nan
    assert positions(motion, sharp)[-1] == pytest.approx(0.049)


def test_a_still_clip_gives_a_single_frame():
    kept, _ = chosen_frames(np.zeros(30), np.full(30, 5.0), 10)
    assert list(kept) == [0]
