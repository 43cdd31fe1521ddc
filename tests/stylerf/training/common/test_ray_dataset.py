"""Pixels near something opaque against a dilation and a list of all their numbers; draws from elsewhere."""

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from stylerf.errors import InvalidValue
from stylerf.training.common.ray_dataset import STRETCH, LitPixels, Pixels, RayDataset, near_opaque
from tests.stylerf.training.scenes import box_photo, dome


def blobs(seed: int, shape=(130, 90)) -> np.ndarray:
    """uint8 alpha: a few blobs, some at the border."""
    generator = np.random.default_rng(seed)
    alpha = np.zeros(shape, np.uint8)
    for _ in range(3):
        i, j = generator.integers(0, shape[0]), generator.integers(0, shape[1])
        alpha[i : i + generator.integers(1, 9), j : j + generator.integers(1, 9)] = generator.integers(1, 256)
    return alpha


@pytest.mark.parametrize("shape", [(130, 90), (33, 20), (700, 40)])
def test_near_is_what_rounds_of_dilation_by_a_cross_reach(shape):
    for seed in range(5):
        alpha = blobs(seed, shape)
        expected = binary_dilation(alpha > 0, iterations=max(2, shape[0] // 50))
        assert np.array_equal(near_opaque(alpha), expected)
    assert not near_opaque(np.zeros(shape, np.uint8)).any() and near_opaque(np.ones(shape, np.uint8)).all()


def test_numbers_of_lit_pixels_are_those_of_a_list_of_all():
    """Among them an empty view, a full one, and runs that end with one view and begin with the next."""
    alphas = [
        blobs(0),
        np.zeros((8, 9), np.uint8),
        np.full((5, 7), 255, np.uint8),
        np.full((2, 3), 9, np.uint8),
        blobs(3),
    ]
    flat = [binary_dilation(a > 0, iterations=max(2, a.shape[0] // 50)).ravel() for a in alphas]
    expected = np.flatnonzero(np.concatenate(flat))
    lit = LitPixels(iter(alphas))
    assert np.array_equal(lit[np.arange(len(expected))], expected)
    for begin in np.cumsum([0, *map(len, flat)]):
        assert lit.below(begin) == (expected < begin).sum()
    assert LitPixels(iter([np.zeros((3, 3), np.uint8)])).below(9) == 0


def test_what_is_drawn_does_not_depend_on_where_the_photos_are(tmp_path):
    cameras = dome(6, 2, 40)
    images = [box_photo(camera) for camera in cameras]
    np.concatenate([image.ravel() for image in images]).tofile(tmp_path / "photos")
    reported = []
    mapped = Pixels(np.memmap(tmp_path / "photos", np.uint8, "r"), 4, reported.append)
    banks = [RayDataset(cameras, images), RayDataset(cameras, mapped)]
    assert sum(reported) * STRETCH >= 6 * 40 * 40 * 4
    del reported[:]
    for share in (0.0, 0.9):
        drawn = [bank.draw(3000, np.random.default_rng(5), 4, share) for bank in banks]
        for one, other in zip(*drawn, strict=True):
            assert np.array_equal(one, other)
    assert reported == [3000, 3000]


def test_bytes_that_are_not_the_cameras_are_refused():
    with pytest.raises(InvalidValue, match="bytes"):
        RayDataset(dome(2, 1, 8), Pixels(np.zeros(2 * 64 * 3 - 1, np.uint8), 3))


@pytest.mark.parametrize("among", [0, -1, 3])
def test_rays_are_drawn_among_views_that_there_are(among):
    cameras = dome(2, 1)
    bank = RayDataset(cameras, [box_photo(camera) for camera in cameras])
    with pytest.raises(InvalidValue, match=f"rays of the first {among} of 2 views"):
        bank.choose(4, np.random.default_rng(0), among)
