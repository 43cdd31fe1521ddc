"""Edges kept: known pictures, and what must not change the value."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, shift, zoom

from stylerf.errors import InvalidValue
from stylerf.metrics.edges_kept import edges_kept


def blobs(seed: int, size: tuple[int, int] = (180, 240)) -> np.ndarray:
    """Smooth shapes with sharp borders: [h, w, 3]."""
    field = gaussian_filter(np.random.default_rng(seed).standard_normal(size), 9)
    gray = np.digitize(field / field.std(), (-0.7, 0.4)) / 2
    return np.stack([0.2 + 0.6 * gray, 0.8 - 0.5 * gray, 0.3 + 0.4 * gray], axis=-1)


@pytest.fixture(scope="module")
def photo():
    return blobs(0)


def test_the_photo_itself_keeps_all_and_gray_nothing(photo):
    assert edges_kept(photo, photo) == 1
    assert edges_kept(np.full_like(photo, 0.5), photo) == 0
    barely = 0.5 + 0.001 * np.random.default_rng(0).standard_normal(photo.shape)
    assert edges_kept(barely, photo) == 0  # grain of a gray picture is not stretched into edges


def test_mirrored_and_unrelated_pictures_keep_little(photo):
    assert edges_kept(photo[:, ::-1], photo) < 0.15
    assert np.mean([edges_kept(blobs(seed), photo) for seed in range(1, 6)]) < 0.08


def test_other_contrast_and_inverted_tones_keep_all(photo):
    assert edges_kept(0.5 + (photo - 0.5) * 0.3, photo) > 0.97
    assert edges_kept(1 - photo, photo) > 0.97


def test_edges_may_move_within_the_tolerance_only(photo):
    def moved(pixels: float) -> float:
        return edges_kept(shift(photo, (0, pixels, 0), order=1, mode="nearest"), photo)

    assert moved(1) > 0.97  # the tolerance of 240 pixels is 1.44
    assert moved(1) > moved(3) > moved(8) and moved(8) < 0.25


def test_large_pictures_keep_what_small_ones_do():
    """Slopes per pixel of a picture four times as wide are a quarter of those of the small one."""
    photo, other = (gaussian_filter(blobs(seed, (378, 504)), (2, 2, 0)) for seed in (0, 1))
    half = np.concatenate([photo[:, :252], other[:, 252:]], axis=1)
    kept = [edges_kept(*(zoom(one, (times, times, 1), order=1) for one in (half, photo))) for times in (1, 4)]
    assert 0.3 < kept[0] < 0.7 and kept[1] == pytest.approx(kept[0], abs=0.05)


def test_half_of_the_picture_keeps_half(photo):
    half = photo.copy()
    half[:, 120:] = half[:, 120:].mean((0, 1))
    mask = np.zeros(photo.shape[:2], bool)
    mask[:, :112] = True
    kept = edges_kept(half, photo)
    assert 0.3 < kept < 0.7
    assert edges_kept(half, photo, mask) > 0.97 and edges_kept(half, photo, np.roll(mask, 128, axis=1)) < 0.05


def test_strokes_everywhere_meet_edges_by_chance_only(photo):
    """Without the correction for chance, dense strokes find most edges again."""
    rows, columns = np.mgrid[:180, :240]
    strokes = np.stack([0.5 + 0.5 * np.sin((rows * a + columns * b) / 1.5) for a, b in ((1, 1), (1, -1))]).mean(0)
    assert edges_kept(np.repeat(strokes[..., None], 3, -1), photo) < 0.1


def test_what_has_no_edges_cannot_be_judged(photo):
    with pytest.raises(InvalidValue, match="no edges"):
        edges_kept(photo, np.full_like(photo, 0.3))
    with pytest.raises(InvalidValue, match="one size"):
        edges_kept(photo[1:], photo)
    with pytest.raises(InvalidValue, match="not finite"):
        edges_kept(np.where(photo > 0.7, np.nan, photo), photo)
